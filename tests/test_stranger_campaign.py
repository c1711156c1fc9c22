"""Many strangers, each at a moment of its own: a valid result is that of the undisturbed run."""

from __future__ import annotations

from pathlib import Path

import pytest

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.orchestrator import run_experiment
from support.stranger_campaign import BASE, Case, cases, judged

SEED = 1
pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800), pytest.mark.usefixtures("environment")]


@pytest.mark.parametrize("options", [{}, {"processes": "separate"}], ids=["composed", "separate"])
def test_whatever_a_stranger_does_a_valid_result_is_that_of_the_undisturbed_run(
    tmp_path: Path, options: dict[str, str]
) -> None:
    reference = run_experiment(ExperimentConfig.model_validate(BASE), tmp_path / "reference")
    assert reference.valid
    given = tuple(options.items())
    found = [
        judged(Case(one.kind, one.moment, one.seed, given), reference, tmp_path / f"{number}")
        for number, one in enumerate(cases(SEED))
    ]
    assert {one.verdict for one in found} <= {"same", "refused", "not delivered"}, [
        one for one in found if one.verdict in ("wrong", "silent", "traceback")
    ]
    assert max(one.seconds for one in found) < 60.0
    assert {one.verdict for one in found} >= {"same", "refused"}
