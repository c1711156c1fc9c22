"""The targets of accuracy, as a study judges them, where they are hardest to meet."""

from pathlib import Path

import pytest

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.study import select_conditions
from armimp_bringup.study.engine import Threads
from armimp_bringup.study.study import run_study

pytestmark = pytest.mark.slow

HARDEST = ["friction=0+3,resolution=0+3,perturbation=1", "friction=1,resolution=2,perturbation=2"]
"""The weakest perturbation beside most friction, coarsest sensors, both or none; and the middle."""

COARSEST = "friction=3,resolution=3,perturbation=3"


@pytest.mark.parametrize(
    ("base", "only", "seeds"),
    [
        ({}, HARDEST, "0"),
        ({"joints": 3}, [COARSEST], "0"),
        ({"perturbation_kind": "multisine"}, [COARSEST], "0:4"),
    ],
)
def test_every_target_is_met_by_both_estimators(
    base: dict[str, object], only: list[str], seeds: str, tmp_path: Path
) -> None:
    conditions = select_conditions(only, seeds)
    config = ExperimentConfig.model_validate(base)
    verdict = run_study(config, conditions, tmp_path / "study", Threads(2), figures=False)
    assert verdict.failures() == []
