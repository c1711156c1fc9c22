"""Faults of single signals are found, and sound signals are left alone."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline
from scipy.ndimage import median_filter
from scipy.signal import butter, cont2discrete, lfilter, sosfilt

from armimp_estimation.problems import ProblemCode, Severity
from armimp_estimation.record import TrialRecord, resolution_of
from armimp_estimation.signal_quality import (
    aliased,
    bridged,
    clipping,
    dropouts,
    floating,
    judge_signals,
    mended,
    repeating,
    seam,
    sticking,
    time_jumps,
    without_slow,
    zeros_beyond_chance,
)
from armimp_estimation.systematics import lost_motion
from armimp_estimation.trial import TrialData
from support.problems import codes, having
from support.synthetic_trials import made_record, part_of

RATE = 1000.0


def motion(seed: int, step: float, size: float = 1.0) -> np.ndarray:
    """Slow noise in steps of a resolution."""
    raw = np.random.default_rng(seed).standard_normal(50_000)
    smooth = sosfilt(butter(2, 4.0, fs=RATE, output="sos"), raw)
    steps: np.ndarray = np.round(size * smooth / smooth.std() / step) * step
    return steps


def counts_of(signal: np.ndarray) -> float:
    return float(np.ptp(signal)) / resolution_of(signal)


def clipped(signal: np.ndarray) -> list[tuple[float, int]]:
    return clipping(signal, resolution_of(signal))


def zeros(signal: np.ndarray) -> int:
    return zeros_beyond_chance(signal, resolution_of(signal))


LOGGERS = ["late", "slow", "fast", "jittering"]


def logged(signals: np.ndarray, logger: str) -> np.ndarray:
    """Readings (..., N) that were interpolated between instants onto those of a logger."""
    k = np.arange(signals.shape[-1])
    jitter = 0.2 * np.sin(np.arange(k.size) ** 2) + 0.2
    paced = {"late": k + 0.37, "slow": 0.9997 * k, "fast": 1.0008 * k}
    at = paced.get(logger, k + jitter)
    return np.apply_along_axis(lambda signal: np.interp(at, k, signal), -1, signals)


@pytest.mark.parametrize("step", [1e-12, 1e-5])
def test_values_that_last_by_chance_or_by_a_fault_say_nothing_of_the_resolution(
    step: float,
) -> None:
    signal = motion(1, step)
    counts = counts_of(signal)
    signal[9000:9500], signal[20000:20500] = signal[9000], signal[20000]
    signal[::1000] = signal[1::1000]
    assert counts_of(signal) == pytest.approx(counts, rel=0.1)


@pytest.mark.parametrize("logger", LOGGERS)
@pytest.mark.parametrize("seed", range(3))
def test_coarse_readings_between_which_a_logger_interpolated_are_sound(
    seed: int, logger: str
) -> None:
    locked = logged(motion(seed, 1.0, 5.0), logger)
    assert clipped(locked) == []
    flicker = np.repeat(np.random.default_rng(seed).random(10_000) < 0.002, 5)
    resting = logged(flicker[None], logger)
    assert mended(made_record(resting, resting))[1] == []
    for size in (0.6, 6.0):
        noise = np.random.default_rng(seed).normal(scale=size, size=50_000)
        torque = logged(np.round(motion(seed, 0.01, 10.0) + noise), logger)
        assert zeros(torque) == 0
        assert repeating(torque) == 0.0


@pytest.mark.parametrize("step", [1e-9, 1e-4, 1e-2, 0.1])
@pytest.mark.parametrize("seed", range(5))
def test_a_signal_that_turns_where_it_likes_is_neither_clipped_nor_stuck(
    seed: int, step: float
) -> None:
    signal = motion(seed, step)
    assert clipped(signal) == []
    assert sticking(signal, RATE, motion(9, 1e-3))[1] == 0


@pytest.mark.parametrize("limit", [1.5, 2.5])
@pytest.mark.parametrize("step", [1e-9, 1e-2])
def test_a_clipped_signal_is_found_with_its_limit(limit: float, step: float) -> None:
    found = clipped(np.clip(motion(1, step), -10.0, limit))
    assert [value for value, _ in found] == [pytest.approx(limit)]


@pytest.mark.parametrize("step", [1e-4, 1e-2])
def test_a_joint_that_rests_at_its_extreme_value_is_not_clipped(step: float) -> None:
    signal = motion(1, step)
    top = int(np.argmax(signal))
    assert clipped(np.insert(signal, top, np.full(400, signal[top]))) == []


@pytest.mark.parametrize("seconds", [0.3, 1.0])
def test_a_signal_that_keeps_its_value_for_too_long_is_stuck(seconds: float) -> None:
    signal = motion(1, 1e-3)
    signal[9000 : 9000 + int(seconds * RATE)] = signal[9000]
    longest, count, limit = sticking(signal, RATE, motion(2, 1e-3))
    assert count == 1
    assert limit < longest == pytest.approx(seconds, abs=0.05)


def test_a_joint_that_rests_as_its_torque_does_or_where_friction_holds_it_is_not_stuck() -> None:
    signal, torque, other = (motion(seed, 1e-3) for seed in (1, 2, 3))
    top = int(np.argmax(signal))
    held = np.insert(signal, top, np.full(500, signal[top]))
    assert sticking(held, RATE, np.insert(torque, top, other[:500]))[1] == 0
    signal[9000:9500], torque[9000:9500] = signal[9000], torque[9000] + other[:500] / 20.0
    assert sticking(signal, RATE, torque)[1] == 0
    # Likewise a joint that rests most of the time, between pulses.
    pulses = np.zeros(50_000)
    for start in range(3000, 50_000, 4000):
        pulses[start : start + 1000] = np.round(100.0 * np.sin(np.arange(1000) / 100.0))
    torque = np.roll(pulses, -5) + np.random.default_rng(1).integers(0, 2, pulses.size)
    assert sticking(pulses, RATE, torque)[1] == 0


def replaced(length: int, value: float | None) -> np.ndarray:
    """Motion in which bursts, 2 % of it, are held at their first value or at a given one."""
    signal = motion(1, 1e-3)
    for start in np.random.default_rng(2).integers(1, signal.size - length, 1000 // length):
        signal[start : start + length] = signal[start] if value is None else value
    return signal


@pytest.mark.parametrize(
    ("length", "value"), [(1, 0.0), (10, 0.0), (10, 5.0), (20, None), (50, None)]
)
def test_a_signal_that_drops_out_for_milliseconds_is_found(
    length: int, value: float | None
) -> None:
    count, share = dropouts(replaced(length, value), motion(3, 1e-3))
    assert count >= 500 // length / 2
    assert 0.005 < share < 0.03


@pytest.mark.parametrize(("length", "value"), [(1, 0.0), (5, 0.0), (3, 9.0), (1, None)])
def test_readings_that_are_lost_now_and_then_are_interpolated_and_counted(
    length: int, value: float | None
) -> None:
    torque = np.stack([motion(1, 1e-3), motion(2, 1e-3)])
    rng = np.random.default_rng(3)
    lost = (20 + 50 * rng.choice(900, 100 // length, replace=False))[:, None] + np.arange(length)
    spoiled = torque.copy()
    spoiled[0, lost.ravel()] = rng.normal(scale=5.0, size=lost.size) if value is None else value
    command = np.cumsum(rng.normal(size=torque.shape), axis=1) / 100.0
    record, problems = mended(made_record(torque, spoiled + command, command=command))
    assert np.max(np.abs(record.torque - torque - command)) < 0.5
    assert [(one.code, one.severity) for one in problems] == [(ProblemCode.MENDED, Severity.NOTE)]
    assert 0.6 * lost.size < float(problems[0].values["count"]) <= lost.size


@pytest.mark.parametrize(("share", "severity"), [(0.002, Severity.NOTE), (0.01, Severity.ERROR)])
def test_a_signal_of_which_much_is_lost_is_refused(share: float, severity: Severity) -> None:
    torque = motion(1, 1e-3)
    torque[np.random.default_rng(2).random(torque.size) < share] = 9.0
    record = made_record(motion(3, 1e-3)[None], torque[None])
    assert [one.severity for one in mended(record)[1]] == [severity]
    # Also beside a longer stretch that is sound.
    sound = mended(record)[0]
    found = TrialData.of(sound, part_of(record, 0, 40_000), segment=2048).problems
    assert [one.severity for one in found] == [severity]


def test_a_signal_without_resolution_is_not_clipped() -> None:
    assert clipping(np.random.default_rng(1).standard_normal(5000), 0.0) == []


@pytest.mark.parametrize("source", ["command", "perturbation"])
@pytest.mark.parametrize("step", [1e-9, 1e-3, 0.1])
def test_a_sound_record_stays_as_it_is_however_commands_chatter(step: float, source: str) -> None:
    command = np.random.default_rng(3).choice(
        (-2.0, 0.0, 2.0), (1, 50_000), p=(0.001, 0.998, 0.001)
    )
    torque = motion(1, step) + 0.5 * np.roll(command, 1) - 0.2 * np.roll(command, 2)
    record = made_record(motion(3, 1e-3)[None], torque, **{source: command})
    kept, problems = mended(record)
    assert kept is record
    assert problems == []


@pytest.mark.parametrize("zone", [0.03, 0.1])
@pytest.mark.parametrize("step", [1e-9, 1e-2])
def test_a_dead_zone_leaves_more_zeros_than_chance(zone: float, step: float) -> None:
    signal = motion(1, step)
    dead = np.where(np.abs(signal) <= zone, 0.0, signal)
    assert zeros(dead) == pytest.approx(0.8 * zone * signal.size, rel=0.5)


@pytest.mark.parametrize("step", [1e-9, 1e-2, 0.3, 3.0])
def test_a_sound_signal_has_no_zeros_too_many_even_if_it_rests_there(step: float) -> None:
    signal = motion(1, step)
    assert zeros(signal) == zeros(signal * (1.0 + 0.05 * motion(4, 1e-9))) == 0
    crossing = int(np.argmin(np.abs(signal)))
    assert zeros(np.insert(signal, crossing, np.zeros(20_000))) == 0
    resting = np.random.default_rng(2).normal(scale=0.6, size=20_000)
    assert zeros(np.insert(signal, crossing, step * np.round(resting))) == 0


def lively(seed: int, step: float) -> np.ndarray:
    """Motion with quick noise, in steps of a resolution."""
    noise = np.random.default_rng(seed + 9).standard_normal(50_000)
    return np.asarray(np.round((motion(seed, 1e-9) + 0.1 * noise) / step) * step)


@pytest.mark.parametrize("step", [1e-9, 1e-3])
def test_a_signal_that_was_held_filtered_or_interpolated_repeats_itself(step: float) -> None:
    signal = lively(1, step)
    k = np.arange(signal.size)
    spoiled = [
        np.repeat(signal[::4], 4),
        median_filter(signal, 5),
        np.interp(k, k[::10], signal[::10]),
        np.interp(k, k[:-8:8] + 0.4, signal[:-8:8]),
    ]
    assert all(repeating(one) > 0.3 for one in spoiled)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("step", [1e-9, 1e-3, 1e-2, 0.1, 1.0])
def test_a_sound_signal_doesn_t_repeat_itself_however_coarse(step: float, seed: int) -> None:
    for signal in (motion(seed, step), lively(seed, step)):
        assert repeating(signal) == 0.0
        assert repeating(signal * (1.0 + 0.1 * signal**2)) == 0.0, "through a table"


@pytest.mark.parametrize("rate", [1000.0, 200.0])
@pytest.mark.parametrize("step", [1e-9, 1e-3])
def test_gaps_that_were_filled_by_lines_or_cubics_are_found(rate: float, step: float) -> None:
    sound = motion(1, step)[:: round(RATE / rate)]
    k = np.arange(sound.size)
    lost = k % rate >= 0.8 * rate
    assert bridged(sound, rate) == 0.0
    for order in (1, 3):
        knots = k[~lost][::15]
        filled = np.where(lost, make_interp_spline(knots, sound[knots], order)(k), sound)
        assert bridged(filled, rate) == pytest.approx(0.2, abs=0.03)
    record = made_record(filled[None], None, sound[None], rate=rate)
    assert ProblemCode.INTERPOLATED in codes(judge_signals(record))


@pytest.mark.parametrize("every", [1, 2, 4, 10])
@pytest.mark.parametrize("step", [1e-3, 1e-2, 0.1])
def test_a_slow_or_coarse_signal_doesn_t_drop_out(every: int, step: float) -> None:
    signal = np.repeat(motion(1, step)[::every], every)
    assert dropouts(signal, motion(3, 1e-3)) == (0, 0.0)


def test_a_locked_joint_that_its_law_throws_back_as_its_angle_steps_doesn_t_drop_out() -> None:
    """Between the steps of a coarse encoder joint and torque rest, then the torque dies away."""
    moving = motion(3, 1e-3)
    torque, angle = np.zeros_like(moving), np.zeros_like(moving)
    t = np.arange(250)
    for start in range(200, moving.size - 300, 300):
        angle[start : start + 150] = 1e-3
        torque[start + 1 : start + 251] = np.round(np.exp(-0.1 * t) + 0.02 * np.cos(t), 3)
    assert dropouts(torque, moving)[0] > 30
    assert dropouts(torque, moving, np.zeros_like(angle))[0] > 30
    assert dropouts(torque, moving, angle) == (0, 0.0)


@pytest.mark.parametrize("source", ["command", "perturbation"])
@pytest.mark.parametrize(
    ("factor", "inertia", "told"),
    [(1.3, 0.0, True), (1.3, 0.1, False), (0.7, 0.02, False)],
    ids=["copy", "arm", "heavy arm"],
)
def test_a_copy_of_command_or_perturbation_is_told_from_a_torque_on_the_arm(
    source: str, factor: float, inertia: float, told: bool
) -> None:
    record = trials_of(motion(3, 1.0))[0]
    given = np.stack((motion(2, 1e-3), np.zeros(record.samples)))
    torque = factor * np.roll(given, 1, axis=1) - inertia * motion(5, 1e-3)
    streams: dict[str, Any] = {"torque": torque, source: given}
    found = judge_signals(replace(record, **streams))
    copied = having(found, ProblemCode.TORQUE_IS_COMMAND)
    assert [one.values["source"] for one in copied] == [source] * told


def trials_of(locked: np.ndarray) -> list[TrialRecord]:
    """Two trials in which the locked joint moves alike; the resolution is 1."""
    moving = motion(1, 1.0, 100.0)
    return [
        made_record(np.stack(angles), trial=k + 1, perturbed_joint=k)
        for k, angles in enumerate(([moving, locked], [locked, moving]))
    ]


def test_a_joint_that_rests_within_a_step_may_move_unseen() -> None:
    slow = np.round(np.linspace(0.0, 3.0, 50_000))
    records = trials_of(slow)
    share, beside = lost_motion(records)
    assert share[1, 0] == 1.0
    assert beside[1, 0] == pytest.approx(0.16)


def test_a_channel_behind_a_high_pass_shows_nothing_slow_and_others_do() -> None:
    high_pass = butter(1, 0.3, "high", fs=RATE, output="sos")
    records = []
    for k in range(2):
        signals = np.stack([motion(4 * k + place, 1e-6) for place in range(4)])
        signals[0] = sosfilt(high_pass, signals[0])
        signals[2] = 1.1 + sosfilt(high_pass, signals[2])
        records.append(made_record(signals[2:], signals[:2], trial=k + 1, perturbed_joint=k))
    assert without_slow(records).tolist() == [[True, False], [True, False]]


@pytest.mark.parametrize("logger", LOGGERS)
def test_a_logger_that_interpolates_hides_no_motion_that_rounding_loses(logger: str) -> None:
    records = trials_of(motion(2, 1.0, 0.3))
    share, beside = lost_motion(records)
    assert share[1, 0] > 0.3
    records = [replace(one, position=logged(one.position, logger)) for one in records]
    shares = lost_motion(records)
    np.testing.assert_allclose(shares, (share, beside), atol=0.02)


def pushed(keep: int, *, hold: int = 1, person: float = 0.0) -> TrialRecord:
    """An arm under a white torque, of which a recorder keeps one sample in several."""
    rng = np.random.default_rng(7)
    push = np.repeat(rng.standard_normal(40_000 // hold), hold)
    numerator, denominator, _ = cont2discrete(([1.0], [0.15, 0.8, 10.0]), 1.0 / RATE)
    slow = sosfilt(butter(2, 2.0, fs=RATE, output="sos"), rng.standard_normal(push.size))
    moved = lfilter(numerator[0], denominator, push + person * slow / slow.std())
    angle = moved + 1e-6 * rng.standard_normal(push.size)
    return made_record(angle[None, ::keep], None, push[None, ::keep], rate=RATE / keep)


@pytest.mark.parametrize(("keep", "hold"), [(4, 1), (5, 1), (10, 2)])
def test_a_perturbation_of_which_samples_were_dropped_is_reported(keep: int, hold: int) -> None:
    assert aliased(pushed(keep, hold=hold)) < 0.6
    assert ProblemCode.ALIASED in codes(judge_signals(pushed(keep, hold=hold)))


@pytest.mark.parametrize(("keep", "hold", "person"), [(1, 1, 0.3), (5, 5, 0.3), (5, 30, 1.0)])
def test_a_white_perturbation_that_is_recorded_as_it_acts_is_sound(
    keep: int, hold: int, person: float
) -> None:
    assert aliased(pushed(keep, hold=hold, person=person)) == 1.0


@pytest.mark.parametrize("many", [0, 2])
def test_samples_that_were_lost_or_recorded_twice_in_all_streams_are_found(many: int) -> None:
    push = motion(1, 1e-9)
    angle = np.round(np.cumsum(push) / RATE, 5)
    times = np.where(np.random.default_rng(2).random(push.size) < 0.01, many, 1)
    spoiled = [np.repeat(one, times)[None, :49_000] for one in (angle, push)]
    assert time_jumps(made_record(spoiled[0], None, spoiled[1])) == pytest.approx(0.01, rel=0.3)
    # A reading that comes too late leaves time as it is.
    late = np.where(times == 1, angle, np.roll(angle, 1))[None]
    assert time_jumps(made_record(late, None, push[None])) < 0.001
    # A controller may itself skip values of the perturbation, or repeat them.
    assert time_jumps(made_record(angle[None, :49_000], None, spoiled[1])) == 0.0


def shaken(kind: str) -> np.ndarray:
    """Angles of a joint under one kind of perturbation, rad, 20 s."""
    rng, t = np.random.default_rng(3), np.arange(20_000) / RATE
    pushes = {
        "noise": rng.standard_normal(t.size),
        "binary": rng.choice([-1.0, 1.0], t.size // 50).repeat(50),
        "chirp": np.sin(2.0 * np.pi * (0.1 + 0.4 * t) * t),
        "fading in": rng.standard_normal(t.size) * t,
        "at rest now and then": rng.standard_normal(t.size) * (np.sin(1.5 * t) > -0.5),
    }
    angle = sosfilt(butter(2, 1.5, fs=RATE, output="sos"), pushes[kind])
    return np.asarray(np.round(0.03 * angle / angle.std() / 2e-5) * 2e-5)


@pytest.mark.parametrize("kind", ["noise", "binary", "chirp", "at rest now and then"])
def test_an_angle_jumps_where_periods_were_joined_and_nowhere_else(kind: str) -> None:
    angle = shaken(kind)
    assert seam(angle) == 0.0
    start = angle[: int(np.argmax(np.abs(angle)))]
    assert seam(np.tile(start, 3)) == pytest.approx(abs(start[-1] - start[0]))


@pytest.mark.parametrize("kind", ["noise", "binary", "chirp", "fading in", "at rest now and then"])
@pytest.mark.parametrize("pushes", [0.0, 0.3, 1.0])
def test_a_joint_that_moves_the_arm_all_the_time_doesn_t_float(kind: str, pushes: float) -> None:
    angle, rng = shaken(kind), np.random.default_rng(4)
    quick = sosfilt(butter(2, 40.0, fs=RATE, output="sos"), np.gradient(np.gradient(angle)))
    slow = sosfilt(butter(2, 2.0, fs=RATE, output="sos"), rng.standard_normal(angle.size))
    torque = 0.05 * RATE**2 * quick + 5.0 * angle + 0.005 * rng.standard_normal(angle.size)
    torque += (np.arange(angle.size) % 5000 < 5000 * pushes) * slow / slow.std()
    assert floating(made_record(angle[None], torque[None])) == (0.0, 0.0)


@pytest.mark.parametrize(("kind", "gap"), [("noise", 0.02), ("noise", 0.04), ("binary", 0.02)])
def test_a_joint_that_moves_within_loose_cuffs_is_reported(kind: str, gap: float) -> None:
    angle, torque, arm, speed = shaken(kind), np.zeros(20_000), 0.0, 0.0
    for tick, at in enumerate(angle):
        torque[tick] = 300.0 * (at - arm - np.clip(at - arm, -gap, gap))
        speed += (torque[tick] - 0.4 * speed - 5.0 * arm) / 0.05 / RATE
        arm += speed / RATE
    record = made_record(angle[None], (1.0 + torque)[None])
    off = np.abs(np.subtract(floating(record), (1.0, 0.7)))
    assert (off < (0.15 * torque.std(), 0.3)).all()
    assert ProblemCode.ARM_FLOATS in codes(judge_signals(record))
