"""Plain PD locking, without any compensation, must fail the verdict, and for the right reason."""

import numpy as np
import pytest
from pydantic import JsonValue

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.offline import simulate
from armimp_estimation.problems import ProblemCode
from armimp_estimation.verdict import Verdict

pytestmark = pytest.mark.slow

OFFLINE = 35.0
"""Of each trial (s): enough for the segments of the study."""
OFF_DIAGONAL = ~np.eye(2, dtype=bool)


@pytest.mark.parametrize("resolution", [0, 3])
def test_locking_by_pd_alone_fails_for_its_lock_quality_though_coherence_looks_fine(
    resolution: int,
) -> None:
    law: dict[str, JsonValue] = {"law": {"kind": "pd"}}
    config = ExperimentConfig(resolution=resolution, duration=OFFLINE, imbic_controller=law)
    (experiment,) = simulate([config])
    result = experiment.identify(("welch_siso", "lpm_full"))

    assert not Verdict.of(result.problems, "welch_siso").impedance
    ratio = np.stack([trial.lock_ratio for trial in result.trials], axis=1)[OFF_DIAGONAL]
    bound = np.stack([trial.bias_bound for trial in result.trials], axis=1)
    assert np.all(ratio > 0.03)  # limit 0.02
    assert np.all(bound > 0.2)  # limit 0.1
    unlocked = {
        (one.values["name"], one.values["perturbed"])
        for one in result.problems
        if one.code is ProblemCode.LOCK_RATIO
    }
    assert unlocked == {("elbow", "shoulder"), ("shoulder", "elbow")}
    codes = {one.code for one in result.problems}
    assert ProblemCode.LOCK_BIAS in codes
    # By coherence alone nobody would notice, though the estimate of the paper is useless.
    siso = result.estimators["welch_siso"]
    assert np.all(siso.coherence_derived >= 0.9)
    assert ProblemCode.NO_RESPONSE not in codes
    assert siso.vaf is not None
    assert np.max(siso.vaf) < 90.0
    assert np.min(siso.vaf) < 0.0
    if resolution == 0:
        # Inversion of the whole matrix undoes coherent motion.
        vaf = result.estimators["lpm_full"].vaf
        assert vaf is not None
        assert np.min(vaf) > 99.0
        assert result.deciding == ("lpm_full",)
        assert Verdict.of(result.problems, "lpm_full").impedance
