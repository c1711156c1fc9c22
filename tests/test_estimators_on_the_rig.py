"""Estimators on simulated trials: targets in the hardest conditions, bias, all joints at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from armimp_bringup.offline import OfflineTrial, run_offline
from armimp_bringup.parameters import Rig
from armimp_control import presets as control_presets
from armimp_control.safety_limiter import SafetyParameters
from armimp_control.sequence import SequenceParameters
from armimp_estimation import scores
from armimp_estimation.fit import fit_mbk
from armimp_estimation.identify import EstimatorResult, identify
from armimp_estimation.mbk import MBK
from armimp_estimation.record import TrialRecord
from armimp_estimation.spectra import WelchConfig
from armimp_estimation.trial import TrialData
from armimp_sim import presets as sim_presets
from armimp_sim.plant import PlantConfig
from armimp_sim.voluntary import VoluntaryParameters
from research.decomposition_trials import run_together
from research.mimo import estimate_mimo

pytestmark = pytest.mark.slow

FloatArray = NDArray[np.float64]
Condition = tuple[int, int, int]

_ARM = sim_presets.human_arm(2)
TRUTH = MBK(M=_ARM.inertia, B=_ARM.damping, K=_ARM.stiffness)
# Friction, resolution and perturbation: the least perturbation with most friction, coarsest
# sensors, both, and something between.
CONDITIONS: tuple[Condition, ...] = ((3, 0, 1), (0, 3, 1), (3, 3, 1), (1, 2, 2))
PUSHED_RUNS = 8
ESTIMATORS = ("direct", "welch_siso", "welch_full", "lpm_full")


def _rig(condition: Condition, *, seed: int, duration: float, push: float = 0.0) -> Rig:
    friction, resolution, level = condition
    robot = sim_presets.robot(2)
    return Rig(
        plant=PlantConfig(
            arm=_ARM,
            robot=robot,
            friction=sim_presets.friction(friction, 2),
            sensors=sim_presets.sensors(resolution),
        ),
        voluntary=VoluntaryParameters(rms=push),
        controller=control_presets.imbic(robot.mass_matrix(_ARM.posture), _ARM.posture),
        safety=SafetyParameters(),
        perturbation=control_presets.perturbation(level, 2),
        sequence=SequenceParameters(duration=duration),
        seed=seed,
    )


def _record(trial: OfflineTrial, *, with_command: bool = True) -> TrialRecord:
    return TrialRecord(
        trial=trial.joint + 1,
        perturbed_joint=trial.joint,
        rate=1000.0,
        joint_names=("shoulder", "elbow"),
        perturbation=trial.perturbation,
        position=trial.position,
        torque=trial.torque,
        start_ns=0,
        seed=None,
        command=trial.command if with_command else None,
    )


def _local(trials: Sequence[OfflineTrial], *, with_command: bool) -> EstimatorResult:
    data = [TrialData.from_record(_record(trial, with_command=with_command)) for trial in trials]
    return identify(data, ["lpm_full"], TRUTH).estimators["lpm_full"]


def _errors(mbk: MBK) -> FloatArray:
    """Largest relative errors of M, B and K, %."""
    pairs = ((mbk.M, TRUTH.M), (mbk.B, TRUTH.B), (mbk.K, TRUTH.K))
    return np.array([100.0 * np.max(np.abs(found / true - 1.0)) for found, true in pairs])


@pytest.fixture(scope="module")
def relaxed() -> dict[Condition, list[OfflineTrial]]:
    rigs = [_rig(condition, seed=4, duration=50.0) for condition in CONDITIONS]
    return dict(zip(CONDITIONS, run_offline(rigs), strict=True))


@pytest.fixture(scope="module")
def pushed() -> list[list[OfflineTrial]]:
    return run_offline(
        [_rig((1, 1, 3), seed=seed, duration=20.0, push=0.3) for seed in range(PUSHED_RUNS)]
    )


@pytest.fixture(scope="module")
def together() -> dict[Condition, OfflineTrial]:
    rigs = [_rig(condition, seed=4, duration=50.0) for condition in CONDITIONS]
    return {c: trials[0] for c, trials in zip(CONDITIONS, run_together(rigs), strict=True)}


@pytest.mark.parametrize("condition", CONDITIONS)
def test_local_polynomials_meet_their_targets_with_room_to_spare(
    relaxed: dict[Condition, list[OfflineTrial]], condition: Condition
) -> None:
    result = _local(relaxed[condition], with_command=True)
    assert result.vaf is not None
    assert np.min(result.vaf) > 99.9
    assert np.min(result.fit.r2) > 0.998
    assert np.min(result.coherence_derived) > 0.985
    assert (_errors(result.fit.mbk) < 1.0).all()


@pytest.mark.parametrize("condition", CONDITIONS)
def test_without_commands_the_errors_hold_what_is_not_known_of_instant_and_friction(
    relaxed: dict[Condition, list[OfflineTrial]], condition: Condition
) -> None:
    fit = _local(relaxed[condition], with_command=False).fit
    for name in ("M", "B", "K"):
        error = getattr(fit.mbk, name) - getattr(TRUTH, name)
        assert (np.abs(error) < 3.0 * getattr(fit, f"{name}_se")).all()
    assert (_errors(fit.mbk) < 2.5).all()


def test_under_voluntary_torque_the_direct_estimate_is_biased_and_the_others_are_not(
    pushed: list[list[OfflineTrial]],
) -> None:
    stiffness: dict[str, list[float]] = {name: [] for name in ESTIMATORS}
    for trials in pushed:
        welch = WelchConfig.for_samples(20_000)
        data = [TrialData.from_record(_record(trial), welch) for trial in trials]
        for name, result in identify(data, ESTIMATORS).estimators.items():
            f, Z = result.estimate.f, result.estimate.Z
            band = (f > 0.3) & (f < 1.5)
            true = TRUTH.impedance(f[band])
            relative = (Z[:, :, band] - true) / np.abs(true)
            # Of the elbow, whose perturbation is the smaller one.
            stiffness[name].append(np.median(relative.real, axis=2)[1, 1])
    mean = {name: np.mean(values) for name, values in stiffness.items()}
    uncertain = {
        n: np.std(values, ddof=1) / np.sqrt(PUSHED_RUNS) for n, values in stiffness.items()
    }
    assert mean["direct"] < -0.3
    assert mean["direct"] < -5.0 * uncertain["direct"]
    for name in ESTIMATORS[1:]:
        assert abs(mean[name]) < 4.0 * uncertain[name]
        assert abs(mean[name]) < 0.5 * abs(mean["direct"])


def test_standard_errors_under_voluntary_torque_are_those_of_the_runs(
    pushed: list[list[OfflineTrial]],
) -> None:
    scores_ = []
    for trials in pushed:
        fit = _local(trials, with_command=True).fit
        found = np.stack((fit.mbk.M, fit.mbk.B, fit.mbk.K))
        error = found - np.stack((TRUTH.M, TRUTH.B, TRUTH.K))
        scores_.append(error / np.stack((fit.M_se, fit.B_se, fit.K_se)))
    rms = np.sqrt(np.mean(np.square(scores_)))
    # 8 runs of 12 parameters, not all independent; coverage proper takes hundreds of runs.
    assert 0.75 < rms < 1.35


@pytest.mark.parametrize("condition", CONDITIONS)
def test_all_joints_at_once_give_the_impedance_too(
    together: dict[Condition, OfflineTrial], condition: Condition
) -> None:
    found = estimate_mimo([_record(together[condition])])
    assert np.min(scores.vaf(found.impedance, TRUTH)) > 99.5
    assert np.mean(found.coupling.coherence[0, 1]) < 0.15
    inertia = fit_mbk(found.impedance).mbk.M
    np.testing.assert_allclose(inertia, TRUTH.M, rtol=0.03)


def test_when_all_joints_are_perturbed_expect_all_to_yield_to_the_signals_of_their_trials(
    relaxed: dict[Condition, list[OfflineTrial]], together: dict[Condition, OfflineTrial]
) -> None:
    for condition in CONDITIONS:
        one = together[condition]
        assert one.joint == 0
        for joint, alone in enumerate(relaxed[condition]):
            np.testing.assert_array_equal(one.perturbation[joint], alone.perturbation[joint])
            # It moves about as much as when it was alone.
            ratio = np.std(one.position[joint]) / np.std(alone.position[joint])
            assert 0.5 < ratio < 2.0


def test_each_seed_gives_other_signals_to_all_joints() -> None:
    rigs = [replace(_rig((0, 0, 1), seed=s, duration=0.2), seed=s) for s in (1, 2)]
    (first,), (second,) = run_together(rigs)
    for joint in range(2):
        assert not np.array_equal(first.perturbation[joint], second.perturbation[joint])
    assert not np.array_equal(first.perturbation[0], first.perturbation[1])
