"""Plain PD locking, without any compensation, must fail the verdict, and for the right reason."""

import functools

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import JsonValue

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.offline import simulate
from armimp_estimation.identify import Identification
from armimp_estimation.problems import ProblemCode
from armimp_estimation.verdict import Verdict

pytestmark = pytest.mark.slow

Array = NDArray[np.float64]
OFFLINE = 35.0
"""Of each trial (s): enough for the segments of the study."""
OFF_DIAGONAL = ~np.eye(2, dtype=bool)


@functools.cache
def identified(resolution: int) -> Identification:
    """What the estimators make of a short experiment with friction 3, run without ROS."""
    law: dict[str, JsonValue] = {"law": {"kind": "pd"}}
    config = ExperimentConfig(resolution=resolution, duration=OFFLINE, imbic_controller=law)
    (experiment,) = simulate([config])
    return experiment.identify(("welch_siso", "lpm_full"))


@pytest.mark.parametrize("resolution", [0, 3])
def test_locking_by_pd_alone_fails_for_its_lock_quality_though_coherence_looks_fine(
    resolution: int,
) -> None:
    result = identified(resolution)

    assert not Verdict.of(result.problems, "welch_siso").impedance
    ratio = np.stack([trial.lock_ratio for trial in result.trials], axis=1)[OFF_DIAGONAL]
    bound = np.stack([trial.bias_bound for trial in result.trials], axis=1)
    assert np.all(ratio > 0.03)  # limit 0.02
    assert np.all(bound > 0.2)  # limit 0.1
    for locked, moved in (("elbow", "shoulder"), ("shoulder", "elbow")):
        pairs = [
            (one.values["name"], one.values["perturbed"])
            for one in result.problems
            if one.code is ProblemCode.LOCK_RATIO
        ]
        assert (locked, moved) in pairs
    assert ProblemCode.LOCK_BIAS in {one.code for one in result.problems}
    # By coherence alone nobody would notice, though the estimate of the paper is useless.
    siso = result.estimators["welch_siso"]
    assert np.all(siso.coherence_derived >= 0.9)
    assert ProblemCode.NO_RESPONSE not in {one.code for one in result.problems}
    assert siso.vaf is not None
    assert np.max(siso.vaf) < 90.0
    assert np.min(siso.vaf) < 0.0


def test_when_an_estimator_copes_with_poor_locking_expect_only_the_other_to_be_refused() -> None:
    """Inversion of the whole matrix undoes coherent motion."""
    result = identified(0)

    vaf = result.estimators["lpm_full"].vaf
    assert vaf is not None
    assert np.min(vaf) > 99.0
    assert result.deciding == ("lpm_full",)
    assert Verdict.of(result.problems, "lpm_full").impedance
    assert not Verdict.of(result.problems, "welch_siso").impedance
