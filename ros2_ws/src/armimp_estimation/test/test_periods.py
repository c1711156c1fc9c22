"""Perturbations that repeat themselves: found as recorded, and estimated from whole periods."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import butter, lfilter, sosfilt

from armimp_common.arrays import FloatArray as Array
from armimp_estimation.distortion import Distortion
from armimp_estimation.mbk import MBK
from armimp_estimation.nonlinear_terms import TERMS
from armimp_estimation.nonlinearity import Deviation, deviations
from armimp_estimation.periods import Periods, common_lines
from armimp_estimation.record import TrialRecord
from armimp_estimation.residual_torque import Residual
from armimp_estimation.trial import SIGNIFICANT, cleaned, segment_for, slopes_of
from support import known
from support.synthetic_trials import LOOP, TWO_JOINT_ARM, made_record, part_of, synthetic_trial

PERIOD = 4096
LINES = np.array([1, 3, 5, 9, 11, 15, 17, 19, 21, 25, 31])


def multisine(count: float, lines: NDArray[np.intp] = LINES) -> Array:
    phases = np.random.default_rng(4).uniform(0.0, 2.0 * np.pi, (lines.size, 1))
    t = np.arange(PERIOD) / PERIOD
    one = np.sum(np.cos(2.0 * np.pi * lines[:, None] * t + phases), axis=0)
    return np.resize(one, round(count * PERIOD))


def lagging_behind(signal: Array, pole: float) -> Array:
    """A signal through a low-pass of first order that starts from rest."""
    return np.asarray(lfilter([1.0 - pole], [1.0, -pole], signal))


def angle_of(source: Array) -> Array:
    """Motion under a torque: a low-pass of 50 ms, scaled to a standard deviation of 0.045 rad."""
    angle = lagging_behind(source, np.exp(-1e-3 / 0.05))
    return np.asarray(angle * (0.045 / np.std(angle)))


ARM = MBK(M=np.array([[0.02]]), B=np.array([[0.2]]), K=np.array([[8.0]]))


def torque_of(angle: Array) -> Array:
    """Torque with which `ARM` answers a motion."""
    f = np.asarray(np.fft.rfftfreq(angle.size, 1e-3), dtype=np.float64)
    return np.asarray(np.fft.irfft(ARM.impedance(f)[0, 0] * np.fft.rfft(angle), angle.size))


def elbow(perturbation: Array, position: Array, torque: Array) -> TrialRecord:
    """A trial of one joint, sampled at 1 kHz."""
    return made_record(position[None], torque[None], perturbation[None])


IN_TIME = {name for name, one in TERMS.items() if one.in_time}


def found_in(record: TrialRecord, arm: MBK = ARM) -> list[dict[str, Deviation]]:
    return deviations(known(Residual.of(record, arm)))


def significant(record: TrialRecord, arm: MBK = ARM) -> dict[str, Deviation]:
    return {name: one for name, one in found_in(record, arm)[0].items() if one.significant}


def test_periods_and_lines_are_found_in_the_signal_itself() -> None:
    found = known(Periods.of(multisine(5.3)))
    assert (found.samples, found.count, found.used) == (PERIOD, 5, 5 * PERIOD)
    assert np.array_equal(found.lines, LINES)
    assert found.segment == PERIOD
    assert known(Periods.of(multisine(5.3, np.arange(1, 20)))).segment == 2 * PERIOD


def test_periods_are_those_between_fading_in_and_fading_out_or_a_rest() -> None:
    signal, fading = multisine(5.3), round(0.8 * PERIOD)
    signal[:fading] *= np.linspace(0.0, 1.0, fading)
    found = known(Periods.of(signal))
    assert (found.samples, found.count) == (PERIOD, 4)
    for after in (
        np.zeros(PERIOD // 3),
        signal[: PERIOD // 3] * np.linspace(0.9, 0.0, PERIOD // 3),
    ):
        resting = known(Periods.of(np.append(signal, after)))
        assert (resting.end, resting.count) == (found.end, found.count) == (signal.size, 4)


@pytest.mark.parametrize("digits", [6, 4])
def test_a_signal_that_was_rounded_on_its_way_still_repeats_itself(digits: int) -> None:
    assert Periods.of(np.round(multisine(3.1), digits)) is not None


@pytest.mark.parametrize(
    "signal",
    [
        synthetic_trial(TWO_JOINT_ARM, 0, LOOP, 3).perturbation[0],
        multisine(1.9),
        multisine(3.0) + 1e-3 * np.random.default_rng(1).standard_normal(3 * PERIOD),
        np.zeros(5000),
        np.sin(np.arange(5000) / 100.0),
    ],
    ids=["noise", "not twice", "disturbed", "nothing", "one sine"],
)
def test_what_does_not_repeat_itself_or_has_too_few_lines_has_no_periods(signal: Array) -> None:
    assert Periods.of(signal) is None


def test_segments_are_periods_that_all_trials_have_or_else_suit_the_shortest() -> None:
    loop = dataclasses.replace(LOOP, samples=50_000, rate=1000.0)
    record = synthetic_trial(TWO_JOINT_ARM, 0, loop, 3)
    periodic = dataclasses.replace(record, perturbation=np.stack([multisine(12.3)[:50_000]] * 2))
    assert segment_for([[periodic], [periodic]]) == 4096
    assert segment_for([[periodic], [record]]) == 8192
    assert segment_for([[record], [part_of(record, 0, 9000)]]) == 2048
    above_the_band = np.resize([0.5, 0.1, -0.4, -0.6, 0.2, 0.7, -0.5], record.perturbation.shape)
    quick = dataclasses.replace(record, perturbation=above_the_band)
    assert segment_for([[quick]]) == 8192


def test_lines_in_common_are_those_of_all_perturbations_that_are_periodic() -> None:
    def periods(lines: list[int], samples: int) -> Periods:
        return Periods(samples=samples, count=4, lines=np.array(lines), end=4 * samples)

    every, second = periods(list(range(1, 41)), 4000), periods(list(range(1, 21)), 2000)
    common = known(common_lines([every, None, second], 1000.0, (0.3, 9.0)))
    np.testing.assert_allclose(common, np.arange(1, 19) * 0.5)
    few = periods([1, 3, 7], 4000)
    assert common_lines([few, few], 1000.0, (0.1, 9.0)) is not None
    assert common_lines([every, periods(list(range(1, 41)), 3001)], 1000.0, (0.1, 9.0)) is None
    assert common_lines([None, None], 1000.0, (0.1, 9.0)) is None


@pytest.mark.parametrize("slope", [0.0, 0.02])
def test_a_drift_beside_a_periodic_perturbation_is_found_and_none_where_there_is_none(
    slope: float,
) -> None:
    source = multisine(6.2)
    answer = lagging_behind(source, np.exp(-1e-3 / 0.2))
    random = np.random.default_rng(6)
    t = np.arange(source.size) / 1000.0
    angle = 0.05 * answer + 1e-4 * random.standard_normal(t.size)
    torque = answer + slope * t + 0.02 * random.standard_normal(t.size)
    slopes, errors = slopes_of(elbow(source, angle, torque))
    found, error = slopes[1], errors[1]
    assert (np.abs(slopes) > SIGNIFICANT * errors).any() == (slope > 0.0)
    assert abs(found - slope) < 4.0 * error
    assert error < 0.004


@pytest.mark.parametrize(
    ("cubic", "stiffening", "found"),
    [(0.0, 0.0, set()), (8.0, 0.0, {"amplitude"}), (0.0, 0.05, {"time", "drift"})],
    ids=["linear", "cubic", "stiffening"],
)
def test_nonlinear_and_changing_arms_show_beside_a_lag_that_m_b_and_k_do_not_describe(
    cubic: float, stiffening: float, found: set[str]
) -> None:
    """A torque with a lag, so that the fitted arm is wrong at every line."""
    source = multisine(12.2, np.delete(np.arange(1, 60, 2), [3, 6, 9, 14, 17, 21, 26]))
    angle = angle_of(source)
    lagging = lagging_behind(angle, 0.9)
    t = np.linspace(0.0, 1.0, source.size)
    K = 8.0
    torque = K * (lagging + cubic * angle**3 + stiffening * t * angle)
    random = np.random.default_rng(7)
    angle = angle + 1e-5 * random.standard_normal(t.size)
    record = elbow(source, angle, torque + 0.005 * random.standard_normal(t.size))
    arm = MBK(M=np.array([[0.01]]), B=np.array([[0.01]]), K=np.array([[K]]))
    shown = significant(record, arm).keys()
    assert shown >= found
    # Beside dependence on the amplitude all is found that bends like it, but no change in time.
    assert shown.isdisjoint(IN_TIME) if cubic else shown == found


@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("back", ["", " and back"])
@pytest.mark.parametrize(("gain", "stiffness"), [(0.0, 0.0), (0.1, 0.0), (0.0, 0.2)])
def test_a_gain_or_a_stiffness_that_changes_abruptly_or_comes_back_is_found(
    gain: float, stiffness: float, back: str, periodic: bool
) -> None:
    random = np.random.default_rng(3)
    source = multisine(10.0, np.arange(1, 60))
    if not periodic:
        source = lagging_behind(random.standard_normal(source.size), 0.9)
    angle = angle_of(source)
    t = np.linspace(-1.0, 1.0, angle.size)
    later = t**2 if back else np.asarray(t > 0.4, dtype=np.float64)
    torque = torque_of(angle) * (1.0 + gain * later) + stiffness * 8.0 * later * angle
    found = significant(elbow(source, angle, torque + 0.01 * random.standard_normal(angle.size)))
    assert gain or stiffness or not found
    if gain:
        assert found[f"drift{back}"].share == pytest.approx(gain, rel=0.3)
    if stiffness:
        assert found[f"time{back}"].share == pytest.approx(stiffness, rel=0.3)


def test_a_transient_at_the_start_does_not_hide_a_transducer_that_compresses() -> None:
    source = multisine(12.0, np.arange(1, 60))
    angle = angle_of(source) + 0.2 * np.exp(-np.arange(source.size) / 700.0)
    speed = np.gradient(angle, 1e-3)
    torque = ARM.M[0, 0] * np.gradient(speed, 1e-3) + ARM.B[0, 0] * speed + ARM.K[0, 0] * angle
    share = 0.02
    compressed = torque - share / 3.0 * torque**3 / np.var(torque)
    noise = 1e-3 * np.random.default_rng(3).standard_normal(torque.size)
    found = found_in(elbow(source, angle, compressed + noise))[0]["gain"]
    assert found.share == pytest.approx(-share, rel=0.3)
    assert found.error < 0.1 * share


def test_a_slow_torque_that_comes_and_goes_is_no_change_of_arm_or_transducer() -> None:
    slow = butter(1, [0.05, 1.0], "bandpass", fs=1000.0, output="sos")
    changing: list[str] = []
    for seed in range(20):
        random = np.random.default_rng(seed)
        source = lagging_behind(random.standard_normal(40_000), 0.9)
        angle = angle_of(source)
        push = sosfilt(slow, random.standard_normal(angle.size))
        push *= np.repeat(random.exponential(1.0, 10) ** 2, 4000) / np.std(push)
        found = significant(elbow(source, angle, torque_of(angle) + 0.5 * push))
        changing += found.keys() & {"time", "drift"}
    assert len(changing) <= 1


@pytest.mark.parametrize("seed", range(3))
def test_the_torque_of_a_person_beside_sweeps_of_a_servo_is_no_bent_transducer(seed: int) -> None:
    since = np.resize(np.arange(10_000) / 1000.0, 30_000)
    angle = 0.045 * np.sin(2.0 * np.pi * (0.3 + 0.7 * since) * since)
    low_pass = butter(2, 2.0, fs=1000.0, output="sos")
    push = 3.0 * sosfilt(low_pass, np.random.default_rng(seed).standard_normal(angle.size))
    assert significant(elbow(angle, angle, torque_of(angle) + push)).keys() <= IN_TIME


@pytest.mark.parametrize(
    ("bend", "found"),
    [(lambda x: 0.0 * x, set()), (lambda x: x**2, {"even"}), (lambda x: x**3, {"odd"})],
    ids=["linear", "even", "odd"],
)
def test_torque_that_an_arm_does_not_explain_is_sorted_by_its_origin(
    bend: Callable[[Array], Array], found: set[str]
) -> None:
    lines = np.delete(np.arange(1, 60, 2), [3, 6, 9, 14, 17, 21, 26])
    source = multisine(8.4, lines)
    angle = angle_of(source)
    random = np.random.default_rng(7)
    noise = 0.01 * lagging_behind(random.standard_normal(angle.size), 0.99)
    record = elbow(source, angle, 8.0 * angle + 0.02 * bend(angle / 0.045) + noise)
    spring = MBK(M=np.zeros((1, 1)), B=np.zeros((1, 1)), K=8.0 * np.eye(1))
    sorted_out = known(Distortion.of(record, spring))
    others = {"odd": sorted_out.odd, "even": sorted_out.even}
    assert {kind for kind, one in others.items() if one.ratio > one.limit} == found
    assert sorted_out.count == 8
    f = sorted_out.lines.f
    assert np.allclose(f, lines * 1000.0 / PERIOD)
    assert sorted_out.lines.rms == pytest.approx(np.std(record.torque - noise), rel=0.05)
    for kind in others.keys() - found:
        assert others[kind].rms == pytest.approx(others[kind].expected, rel=0.3)
    spectrum = np.abs(np.fft.rfft(noise)) ** 2
    inside = np.fft.rfftfreq(noise.size, 1e-3) <= f[-1]
    inside[0] = False
    whole = float(np.sqrt(2.0 * np.sum(spectrum[inside]))) / noise.size
    assert sorted_out.noise == pytest.approx(whole, rel=0.1)
    resting = elbow(*(np.pad(one, (0, 900)) for one in (source, angle, record.torque[0])))
    assert cleaned([resting])[0][0].samples == source.size
    assert known(Distortion.of(resting, spring)).noise == sorted_out.noise


@pytest.mark.parametrize("loss", [0.0, 0.05])
def test_a_transmission_that_takes_a_share_of_the_torque_while_it_drives_the_arm_is_found(
    loss: float,
) -> None:
    random = np.random.default_rng(3)
    low_pass = butter(4, 10.0, fs=1000.0, output="sos")
    source = sosfilt(low_pass, random.standard_normal(20_000))
    angle = angle_of(source)
    torque = torque_of(angle)
    torque *= 1.0 - loss * (torque * np.gradient(angle) > 0.0)
    found = significant(elbow(source, angle, torque + 0.01 * random.standard_normal(angle.size)))
    assert loss or not found
    if loss:
        assert found["efficiency"].sensor == pytest.approx(-0.5 * loss, rel=0.3)


@pytest.mark.parametrize(
    ("joint", "stiffer", "damped", "named"),
    [(0, 0.0, 0.0, ""), (1, 0.3, 0.0, "amplitude"), (0, 0.0, 1.5, "damping by angle")],
    ids=["linear", "stiffness between joints", "damping"],
)
def test_a_stiffness_between_joints_or_a_damping_that_changes_is_found(
    joint: int, stiffer: float, damped: float, named: str
) -> None:
    random = np.random.default_rng(3)
    source = lagging_behind(random.standard_normal(50_000), 0.9)
    angle = angle_of(source)
    speed, turned = np.gradient(angle, 1e-3), angle / 0.045
    arm = TWO_JOINT_ARM
    torque = np.stack(
        [
            arm.M[i, 0] * np.gradient(speed, 1e-3) + arm.B[i, 0] * speed + arm.K[i, 0] * angle
            for i in range(2)
        ]
    )
    torque[joint] += stiffer * arm.K[joint, 0] * turned**2 * angle
    torque[joint] += damped * arm.B[joint, 0] * np.abs(turned) * speed
    torque += 1e-3 * random.standard_normal(torque.shape)
    held = 1e-7 * random.standard_normal(angle.size)
    record = made_record(np.stack([angle, held]), torque, np.stack([source, 0.0 * source]))
    found = found_in(record, arm)
    names = [{name for name, one in of.items() if one.significant} for of in found]
    assert not names[1 - joint]
    assert named in names[joint] if named else not names[joint]
