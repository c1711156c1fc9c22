"""The targets of accuracy, as a study judges them, where they are hardest to meet."""

from pathlib import Path

import pytest

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.study.conditions import select_conditions
from armimp_bringup.study.engine import Threads
from armimp_bringup.study.study import run_study

pytestmark = pytest.mark.slow

HARDEST = ["friction=0+3,resolution=0+3,perturbation=1", "friction=1,resolution=2,perturbation=2"]
"""The weakest perturbation beside most friction, coarsest sensors, both or none; and the middle."""


@pytest.mark.parametrize(
    ("joints", "only"), [(2, HARDEST), (3, ["friction=3,resolution=3,perturbation=3"])]
)
def test_every_target_is_met_by_both_estimators(
    joints: int, only: list[str], tmp_path: Path
) -> None:
    conditions = select_conditions(only, "0")
    config = ExperimentConfig.model_validate({"joints": joints})
    verdict = run_study(config, conditions, tmp_path / "study", Threads(2), figures=False)
    assert verdict.failures() == []
