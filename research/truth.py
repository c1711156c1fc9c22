"""Verdicts on recordings of an independent rig: false acceptances, and false refusals."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import cache
from itertools import product
from multiprocessing import get_context
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
from scipy.ndimage import median_filter
from scipy.signal import bilinear, butter, lfilter, sosfilt, sosfiltfilt

from armimp_bringup.study import parse_seeds
from armimp_bringup.terminal import display
from armimp_common import topics
from armimp_common.arrays import FloatArray
from armimp_common.errors import ArmimpError, ConfigurationError
from armimp_estimation.alignment.assemble import assemble_trials
from armimp_estimation.alignment.streams import Streams
from armimp_estimation.metadata import CALIBRATION_KEYS, Metadata
from armimp_estimation.result import Result, conclude
from research.independent_rig import (
    NAMES,
    POSTURE,
    ROBOT,
    Mismatch,
    Recording,
    arm_of,
    changed,
    simulate,
)
from research.options import InvestigationOptions
from research.writing import print_table, to_json, write_tables

Stamps = NDArray[np.int64]
Change = Callable[[FloatArray], FloatArray]
MILLI = 1e-3
Outcome = tuple[bool, float, float, list[str]]
"""Valid or not; worst error in standard errors, and in per cent; problems."""


def _clipped(share: float) -> Change:
    def clip(torque: FloatArray) -> FloatArray:
        limit = np.quantile(np.abs(torque), 1.0 - share, axis=1, keepdims=True)
        limit = np.round(limit, 2)
        return np.clip(torque, -limit, limit)

    return clip


def _stuck(seconds: float) -> Change:
    def hold(torque: FloatArray) -> FloatArray:
        torque = torque.copy()
        for start in (9000, 23000, 37000):
            stop = start + int(seconds * 1000)
            torque[0, start:stop] = torque[0, start]
        return torque

    return hold


def _spikes(size: float) -> Change:
    def hit(torque: FloatArray) -> FloatArray:
        torque = torque.copy()
        places = np.random.default_rng(5).integers(600, torque.shape[1] - 600, 40)
        torque[0, places] += size
        return torque

    return hit


def _hum(size: float) -> Change:
    def add(torque: FloatArray) -> FloatArray:
        t = np.arange(torque.shape[1]) / 1000.0
        return torque + size * np.sin(2 * np.pi * 50.0 * t + 0.3)

    return add


def _bursts(size: float) -> Callable[[Recording], Recording]:
    """Noise of the torque below 4 Hz that is as large as the perturbation."""

    def add(recording: Recording) -> Recording:
        noise = np.random.default_rng(9).standard_normal(recording.torque.shape)
        slow = sosfilt(butter(2, 0.008, output="sos"), noise, axis=1)
        push = np.abs(recording.perturbation[recording.joint])
        slow *= size * push / np.std(slow * push, axis=1, keepdims=True)
        return replace(recording, torque=recording.torque + slow)

    return add


def _links(recording: Recording) -> Recording:
    """Torques of two links, whose inertia changes with the angle between them."""
    samples = recording.position.shape[1]
    s = 2j * np.pi * np.fft.rfftfreq(samples, 1e-9 * float(np.diff(recording.stamps[:2])[0]))
    s[np.abs(s) > 2.0 * np.pi * 30.0] = 0.0

    def rate(values: FloatArray) -> FloatArray:
        return np.asarray(np.fft.irfft(s * np.fft.rfft(values), samples))

    upper, lower = rate(recording.position)
    change = -0.06 * (recording.position[1] - np.mean(recording.position[1]))
    torque = recording.torque.copy()
    torque[0] += rate(change * (2.0 * upper + lower))
    torque[1] += rate(change * upper) + 0.06 * upper * (upper + lower)
    return replace(recording, torque=torque)


def _within_calibration(draw: int) -> Callable[[Recording], Recording]:
    """Sensors as those of a laboratory are: off by 1 % (torques) and 1.5 % (angles)."""
    rng = np.random.default_rng(draw)

    def change(recording: Recording) -> Recording:
        n = len(recording.torque)
        return replace(
            recording,
            torque=np.round((np.eye(n) + 0.01 * mixing[:n, :n]) @ recording.torque, 2),
            position=(1.0 + 0.015 * scales[:n, None]) * recording.position,
        )

    mixing, scales = rng.standard_normal((3, 3)), rng.standard_normal(3)
    return change


def _drift(slope: float) -> Change:
    return lambda torque: torque + slope * np.arange(torque.shape[1]) / 1000.0


def _backlash(gap: float) -> Change:
    """Play of a given width: readings follow only once it is taken up."""

    def follow(values: FloatArray) -> FloatArray:
        rows = []
        for row in values.tolist():
            rests, followed = row[0], []
            for value in row:
                rests = min(max(rests, value - 0.5 * gap), value + 0.5 * gap)
                followed.append(rests)
            rows.append(followed)
        return np.array(rows)

    return follow


def _uneven(share: float) -> Change:
    """A transducer that shows more torque in one direction, by a share."""
    return lambda torque: torque + share * np.maximum(torque, 0.0)


def _yielding(share: float) -> Change:
    """A compressive transducer that shows less torque, by a share at the peak."""

    def compress(torque: FloatArray) -> FloatArray:
        peak = np.max(np.abs(torque), axis=1, keepdims=True)
        return np.asarray(torque * (1.0 - share * (torque / peak) ** 2))

    return compress


def _saturating(largest: float) -> Change:
    """An encoder, such as a magnet over a Hall sensor, that shows no more than an angle."""
    return lambda angle: angle[:, :1] + largest * np.tanh((angle - angle[:, :1]) / largest)


def _one_way(share: float) -> Change:
    """An encoder that shows more on one side of its first angle, by a share."""
    return lambda angle: angle + share * np.maximum(angle - angle[:, :1], 0.0)


def _faster(share: float) -> Callable[[Recording], Recording]:
    """A transducer that shows more while the joint moves, by a share at 1 rad/s."""
    step = Mismatch().torque_step

    def show(recording: Recording) -> Recording:
        speed = np.abs(np.gradient(recording.position, MILLI, axis=1))
        shown = recording.torque * (1.0 + share * speed)
        return replace(recording, torque=step * np.rint(shown / step))

    return show


def _dead(zone: float, *, less: bool) -> Change:
    """Dead zone: torques within it read 0; larger ones read as they are, or `less` by the zone."""

    def cut(torque: FloatArray) -> FloatArray:
        beyond = np.maximum(np.abs(torque) - zone, 0.0)
        return np.sign(torque) * (beyond if less else np.where(beyond > 0.0, abs(torque), 0.0))

    return cut


def _lost(share: float, kind: str) -> Change:
    """Single readings that are 0, repeat the value before, or jump by 2 N·m to either side."""

    def lose(torque: FloatArray) -> FloatArray:
        rng = np.random.default_rng(7)
        lost = rng.random(torque.shape) < share
        lost[:, :2] = False
        jumps = torque + rng.choice((-1.0, 1.0), torque.shape) * 2.0
        filled = {"zero": 0.0 * torque, "held": np.roll(torque, 1, axis=1), "spike": jumps}
        return np.where(lost, filled[kind], torque)

    return lose


def _median(samples: int) -> Change:
    return lambda torque: median_filter(torque, size=(1, samples), mode="nearest")


def _slower(rate: float) -> Change:
    """Readings at a lower rate, interpolated to 1 kHz."""
    size = 1000.0 / rate

    def interpolate(torque: FloatArray) -> FloatArray:
        k = np.arange(torque.shape[1])
        known = np.rint(np.arange(0.0, k.size, size)).astype(np.int64)
        return np.stack([np.interp(k, known, row[known]) for row in torque])

    return interpolate


def _bridged(share: float, seconds: float, order: int) -> Change:
    """Readings of which a share is lost, for some time each, and filled in by a spline."""

    def fill(values: FloatArray) -> FloatArray:
        k, size = np.arange(values.shape[1]), round(1000.0 * seconds)
        lost = (k + 500) % round(size / share) >= round(size / share) - size
        knots = k[~lost][:: 15 if order > 1 else 1]
        filled = make_interp_spline(knots, values[:, knots], order, axis=1)(k)
        return np.where(lost, filled, values)

    return fill


def _uneven_counts(share: float, counts: int) -> Change:
    """Encoder whose 61.36 µrad steps are off by up to a share of one, with a period of `counts`."""
    step = Mismatch().angle_step
    off = share * np.random.default_rng(11).uniform(-1.0, 1.0, counts)

    def shift(angle: FloatArray) -> FloatArray:
        rest = POSTURE[: len(angle), None]
        count = np.rint((angle - rest) / step).astype(np.int64)
        return np.asarray(rest + step * (count + off[count % counts]))

    return shift


def _stepped(share: float) -> Change:
    return lambda torque: (
        torque * (1.0 + share * (np.arange(torque.shape[1]) > 0.3 * torque.shape[1]))
    )


def _ramped(share: float, start: float = 0.0, end: float = 1.0) -> Change:
    """A gain that changes by a share times a straight line from start to end."""
    return lambda torque: torque * (1.0 + share * np.linspace(start, end, torque.shape[1]))


def _returning(share: float) -> Change:
    """A gain that falls by a share until the middle of the trial, and comes back."""
    return lambda torque: torque * (1.0 - share * (1.0 - np.linspace(-1, 1, torque.shape[1]) ** 2))


def _restamped(rate: float) -> Callable[[Any], Any]:
    def stamp(stamps: Stamps) -> Any:
        return stamps[0] + np.rint(np.arange(stamps.size) * (1e9 / rate)).astype(np.int64)

    return stamp


def _jittered(share: float) -> Callable[[Any], Any]:
    def stamp(stamps: Stamps) -> Any:
        noise = np.random.default_rng(3).normal(scale=share * 1e6, size=stamps.size)
        return stamps + np.rint(np.clip(noise, -4e5, 4e5)).astype(np.int64)

    return stamp


def _warped(share: float) -> Callable[[Any], Any]:
    def stamp(stamps: Stamps) -> Any:
        x = np.arange(stamps.size)
        return stamps + np.rint(share * 1e6 * x**2 / x.size).astype(np.int64)

    return stamp


def _times(factor: float) -> Change:
    return lambda values: values * factor


def _of_row(row: int, change: Change) -> Change:
    """Apply a change to the channel of one joint alone."""

    def apply(values: FloatArray) -> FloatArray:
        values = values.copy()
        values[row] = change(values[row : row + 1])[0]
        return values

    return apply


def _cross(share: float) -> Change:
    return lambda torque: torque + share * torque[::-1]


def _mixed(share: float) -> Change:
    """The first joint's channel shows a share of the second's, as with a belt."""
    return lambda values: np.concatenate((values[:1] + share * values[1:2], values[1:]))


def _bent(size: float, poles: float) -> Change:
    """Encoder with an eccentric scale: sinusoidal errors with a number of periods per turn."""
    return lambda angle: angle + size * np.sin(poles * angle + 0.4)


def _sampled(at: Callable[[FloatArray], FloatArray]) -> Change:
    """Readings at other instants than their stamps say, interpolated between the samples."""

    def resample(values: FloatArray) -> FloatArray:
        k = np.arange(values.shape[1], dtype=np.float64)
        return np.stack([np.interp(at(k), k, row) for row in values])

    return resample


def _steadied(cutoff: float) -> Change:
    """Readings behind a high-pass of first order, Hz, as of a charge amplifier."""
    high_pass = butter(1, cutoff, "high", fs=1000.0, output="sos")
    return lambda values: np.asarray(sosfilt(high_pass, values - values[:, :1]))


def _creeping(share: float, time: float) -> Change:
    """Readings of a transducer that creeps, whose gain was found with weights."""
    b, a = bilinear([share / (1.0 + share) * -time, 0.0], [time, 1.0], fs=1000.0)
    return lambda torque: np.asarray(torque + lfilter(b, a, torque))


def _smoothed(cutoff: float) -> Change:
    """Readings behind a Butterworth low-pass of order 2, Hz."""
    low_pass = butter(2, cutoff, fs=1000.0, output="sos")

    def smooth(values: FloatArray) -> FloatArray:
        rest = values[:, :1]
        return np.asarray(rest + sosfilt(low_pass, values - rest))

    return smooth


def _swinging(resonance: float) -> Change:
    """Readings of a sensor whose mount has a resonance, Hz, with a damping ratio of 0.05."""
    turning = 2.0 * np.pi * resonance
    numerator, denominator = bilinear([turning**2], [1.0, 0.1 * turning, turning**2], fs=1000.0)

    def swing(values: FloatArray) -> FloatArray:
        rest = values[:, :1]
        return np.asarray(rest + lfilter(numerator, denominator, values - rest))

    return swing


def _unsteady(share: float) -> Change:
    """Readings at instants that jitter, with a standard deviation of a share of a period."""
    return _sampled(lambda k: k + share * np.random.default_rng(9).standard_normal(k.size))


def _recorded(share: float, times: int) -> Callable[[Recording], Recording]:
    """Single samples of all streams recorded 0 or 2 times by a recorder that stamps them itself."""

    def record(values: FloatArray) -> FloatArray:
        size = values.shape[-1]
        chosen = np.random.default_rng(11).random(size) < share
        return np.repeat(values, np.where(chosen, times, 1), axis=-1)[..., :size]

    streams = dict.fromkeys(("position", "torque", "perturbation", "command"), record)
    return changed(**streams, stamps=lambda stamps: stamps[: record(stamps).size])


def _late(samples: float) -> Change:
    return _sampled(lambda k: k - samples)


def _resampled(rate: float) -> Callable[[Recording], Recording]:
    """A recording that was interpolated to another rate."""

    def resample(recording: Recording) -> Recording:
        size = int(recording.stamps.size * rate / 1000.0) - 1
        k = np.arange(size) * (1000.0 / rate)
        stamps = recording.stamps[0] + np.rint(k * 1e6).astype(np.int64)
        assert recording.command is not None
        old = np.arange(recording.stamps.size)
        names = ("position", "torque", "perturbation", "command")
        rows: dict[str, Any] = {
            name: np.stack([np.interp(k, old, row) for row in getattr(recording, name)])
            for name in names
        }
        return replace(recording, stamps=stamps, **rows)

    return resample


def _cable(stiffness: float) -> Callable[[Recording], Recording]:
    """Torques that include those of a cable, N·m/rad, which bends with the joint."""

    def load(recording: Recording) -> Recording:
        bent = recording.position - recording.position[:, :1]
        return replace(recording, torque=recording.torque + stiffness * bent)

    return load


def _efficiency(loss: float) -> Callable[[Recording], Recording]:
    """Torques behind a transmission that loses a share of them while it drives the arm."""

    def lose(recording: Recording) -> Recording:
        drives = recording.torque * np.gradient(recording.position, axis=1) > 0.0
        return replace(recording, torque=recording.torque * (1.0 - loss * drives))

    return lose


def _braked(recording: Recording) -> Recording:
    """Commands to the perturbed joint alone, as where brakes hold the others."""
    assert recording.command is not None
    own = np.arange(len(recording.command)) == recording.joint
    return replace(recording, command=recording.command * own[:, None])


def _perturbed_alone(recording: Recording) -> Recording:
    """Only the angle of the perturbed joint is recorded."""
    moves = np.arange(len(recording.position))[:, None] == recording.joint
    angles = recording.position
    return replace(recording, position=np.where(moves, angles, angles[:, :1]))


def _without_commands(recording: Recording) -> Recording:
    return replace(recording, command=None)


def _then_without_commands(
    change: Callable[[Recording], Recording],
) -> Callable[[Recording], Recording]:
    return lambda recording: _without_commands(change(recording))


def _of_trial(
    joint: int, change: Callable[[Recording], Recording]
) -> Callable[[Recording], Recording]:
    """Change the trial that perturbs one joint alone."""
    return lambda recording: change(recording) if recording.joint == joint else recording


def _about_mean(change: Change) -> Change:
    """Change the motion about the posture."""

    def apply(angle: FloatArray) -> FloatArray:
        posture = angle.mean(axis=1, keepdims=True)
        return np.asarray(posture + change(angle - posture))

    return apply


def _first_lost(recording: Recording) -> Recording:
    return replace(recording, command_shift=1)


def _computed(share: float) -> Callable[[Recording], Recording]:
    """Torque that is not measured, but computed from commands and a model of the robot.

    The model has a share of the robot's inertia; angles are smoothed before their derivatives.
    """
    low_pass = butter(2, 40.0, fs=1000.0, output="sos")

    def compute(recording: Recording) -> Recording:
        n, command = len(recording.position), recording.command
        speed = np.gradient(sosfiltfilt(low_pass, recording.position), MILLI, axis=1)
        model = share * ROBOT[:n, :n] @ np.gradient(speed, MILLI, axis=1) + 0.1 * speed
        return replace(
            recording, torque=np.round(np.roll(np.asarray(command), 1, axis=1) - model, 2)
        )

    return compute


def _shifted(by: int) -> Callable[[Recording], Recording]:
    return changed(command=lambda command: np.roll(command, by, axis=1))


LIMIT = 3.5
"""Standard errors by which a valid element may be off."""
NOISE, MUST = "noise", "must"
"""A class of noise must be valid; others must not be, unless the result is right."""


@cache
def cases() -> dict[str, tuple[str, Mismatch]]:  # noqa: C901, PLR0912, PLR0915 (a table)
    """All classes that are tried: kind and mismatch by name (class, magnitude)."""
    found: dict[str, tuple[str, Mismatch]] = {"ideal": (NOISE, Mismatch())}

    def add(kind: str, name: str, *variants: tuple[str, dict[str, Any]]) -> None:
        for label, options in variants:
            found[f"{name} {label}".strip()] = (kind, Mismatch(**options))

    for rate in (500.0, 800.0, 2000.0):
        add(NOISE, "rate", (f"{rate:g}", {"rate": rate}))
        add(MUST, f"rate {rate:g} after", ("", {"rate": rate, "after": True}))
        amid = {"rate": rate, "torque_delay": 0.5 / rate}
        add(MUST, f"rate {rate:g} mid", ("", amid))
        add(MUST, f"rate {rate:g} mean", ("", {"rate": rate, "mean": True}))
    for rate in (999.9, 980.0, 1020.0, 900.0):
        add(MUST, "stamped", (f"{rate:g}", {"readings": changed(stamps=_restamped(rate))}))
    for share in (0.02, 0.3):
        add(MUST, "jitter", (f"{share:g}", {"readings": changed(stamps=_jittered(share))}))
    add(MUST, "warped", ("1%", {"readings": changed(stamps=_warped(0.01))}))
    add(MUST, "after", ("", {"after": True}))
    add(MUST, "mean", ("", {"mean": True}))
    for late in (0.2, 0.5, 0.8, 1.0, 1.5, 2.0, 4.0):
        add(MUST, "torque late", (f"{late:g} ms", {"torque_delay": late * MILLI}))
    for low in (0.2, 0.5, 1.0, 3.0):
        add(MUST, "torque low-pass", (f"{low:g} ms", {"low_pass": low * MILLI}))
        # A law that knows nothing of the filter is stable with 3 ms only if locks are soft.
        lag = {"angle_low_pass": low * MILLI, "lock": min(150.0, 0.12 / (low * MILLI))}
        add(MUST, "angle low-pass", (f"{low:g} ms", lag))
    for cutoff in (0.016, 0.05, 0.16, 0.5):
        steadied = {"voluntary": 0.3, "readings": changed(torque=_steadied(cutoff))}
        add(MUST, "torque high-pass, voluntary", (f"{cutoff:g} Hz", steadied))
    for cutoff, name in product((0.3, 1.0), ("torque", "position")):
        first = changed(**{name: _of_row(0, _steadied(cutoff))})
        steadied = {"voluntary": 0.3, "readings": first}
        add(MUST, f"{name} of one joint, high-pass, voluntary", (f"{cutoff:g} Hz", steadied))
    for cutoff in (15.0, 30.0):
        alike = changed(position=_smoothed(cutoff), torque=_smoothed(cutoff))
        add(NOISE, "low-pass of angles and torques", (f"{cutoff:g} Hz", {"readings": alike}))
    for cutoff in (20.0, 30.0, 100.0):
        maximally_flat = {"voluntary": 0.3, "readings": changed(torque=_smoothed(cutoff))}
        add(MUST, "torque low-pass of order 2, voluntary", (f"{cutoff:g} Hz", maximally_flat))
    for resonance in (40.0, 80.0, 200.0):
        for name in ("torque", "position"):
            swings = {"voluntary": 0.3, "readings": changed(**{name: _swinging(resonance)})}
            add(MUST, f"{name} that swings, voluntary", (f"{resonance:g} Hz", swings))
    for late in (0.1, 0.3, 0.5, 0.8, 1.0, 1.5, 2.0):
        add(MUST, "command late", (f"{late:g} ms", {"command_delay": late * MILLI, "lock": 50.0}))
    add(NOISE, "no commands", ("", {"readings": _without_commands}))
    for late in (50.0, 300.0):
        paced = _sampled(_times(1.0 - 1e-6 * late))
        streams = dict.fromkeys(("position", "torque", "perturbation", "command"), paced)
        for joints, voluntary in ((2, 0.3), (3, 0.1)):
            logged = {"readings": changed(**streams), "joints": joints, "voluntary": voluntary}
            add(NOISE, f"logged by a slower clock, {joints} joints", (f"{late:g} ppm", logged))
    for late in (20.0, 60.0, 300.0):
        apart = changed(torque=_sampled(_times(1.0 - 1e-6 * late)))
        for voluntary in (0.05, 0.3):
            logged = {"readings": apart, "voluntary": voluntary}
            kind = NOISE if late < 100.0 else MUST
            add(kind, f"torques on another clock, {late:g} ppm", (f"{voluntary:g} N·m", logged))
    no_commands = {"after": True, "readings": _without_commands}
    add(MUST, "no commands, after", ("", no_commands))
    add(MUST, "first command lost", ("", {"readings": _first_lost}))
    for by in (-2, -1, 1, 2):
        add(MUST, "commands shifted", (f"{by}", {"readings": _shifted(by)}))
    flip = changed(command=lambda command: command[::-1].copy())
    add(MUST, "commands permuted", ("", {"readings": flip}))
    add(MUST, "fine sensors", ("", {"angle_step": 0.0, "torque_step": 0.0, "torque_noise": 0.0}))
    smooth = {"angle_step": 1e-7, "torque_step": 1e-3, "torque_noise": 1e-3}
    add(MUST, "fine sensors, after", ("", smooth | {"after": True}))
    add(MUST, "fine sensors, mean", ("", smooth | {"mean": True}))
    add(MUST, "fine sensors, command late", ("0.5 ms", smooth | {"command_delay": 0.5 * MILLI}))
    for name in ("torque", "position", "command", "perturbation"):
        for label, factor in (("sign", -1.0), ("degrees", 57.29578), ("N·mm", 1000.0)):
            add(MUST, f"{name} {label}", ("", {"readings": changed(**{name: _times(factor)})}))
        for row in (0, 1):
            one = changed(**{name: _of_row(row, _times(-1.0))})
            add(MUST, f"{name} sign of joint", (f"{row + 1}", {"readings": one}))
    undeclared: dict[str, Any] = {"calibrated": False}
    for factor in (0.102, 0.5, 0.8, 0.9, 0.95, 1.05, 1.1, 1.25, 2.0, 9.81):
        every: dict[str, Any] = {"readings": changed(torque=_times(factor))}
        add(MUST, "torque gain", (f"{factor:g}", every | undeclared))
        beside: dict[str, Any] = every | undeclared | {"voluntary": 0.3}
        add(MUST, "torque gain, voluntary 0.3 N·m", (f"{factor:g}", beside))
        if factor < 0.9:
            exact = every | {"voluntary": 0.3}
            add(MUST, "torque gain declared exact, voluntary 0.3 N·m", (f"{factor:g}", exact))
        for row in (0, 1):
            wrong = changed(torque=_of_row(row, _times(factor)))
            of_one = (f"{factor:g}", {"readings": wrong} | undeclared)
            add(MUST, f"torque gain of joint {row + 1}", of_one)
    for factor in (0.8, 1.1, 1.2):
        for size, trial in product((0.0, 0.3), (0, 1)):
            for name, by_trial in (
                ("torque", _times(factor)),
                ("position", _about_mean(_times(factor))),
            ):
                anew = {
                    "readings": _of_trial(trial, changed(**{name: by_trial})),
                    "voluntary": size,
                }
                add(MUST, f"{name} of trial {trial + 1} x{factor:g}", (f"{size:g} N·m", anew))
    for trial in (0, 1):
        other_order = _of_trial(
            trial, changed(position=_about_mean(lambda values: values[::-1].copy()))
        )
        add(MUST, f"angles of trial {trial + 1} swapped", ("", {"readings": other_order}))
    for share in (0.7, 0.9, 1.1):
        model = {"friction": 0.0, "readings": _computed(share)}
        add(MUST, "torque computed from the command", (f"{share:g}", model))
    for label, gone in (("", False), (", no commands", True)):
        for name in ("torque", "position"):
            swap = changed(**{name: lambda values: values[::-1].copy()})
            both = _then_without_commands(swap) if gone else swap
            add(MUST, f"{name} swapped{label}", ("", {"readings": both}))
    for label, factor in (("sign", -1.0), ("N·mm", 1000.0), ("degrees", 57.29578)):
        for name in ("torque", "position"):
            wrong = changed(**{name: _times(factor)})
            add(
                MUST,
                f"{name} {label}, no commands",
                ("", {"readings": _then_without_commands(wrong)}),
            )
    for share in (0.002, 0.02, 0.1):
        add(MUST, "clipped", (f"{share:g}", {"readings": changed(torque=_clipped(share))}))
        add(MUST, "angle clipped", (f"{share:g}", {"readings": changed(position=_clip(share))}))
    for seconds in (0.05, 0.3, 2.0):
        add(MUST, "stuck", (f"{seconds:g} s", {"readings": changed(torque=_stuck(seconds))}))
        add(
            MUST, "angle stuck", (f"{seconds:g} s", {"readings": changed(position=_stuck(seconds))})
        )
    for size in (0.5, 5.0, 50.0):
        add(MUST, "spikes", (f"{size:g} N·m", {"readings": changed(torque=_spikes(size))}))
        add(
            MUST,
            "angle spikes",
            (f"{size / 10:g} rad", {"readings": changed(position=_spikes(size / 10))}),
        )
    for size in (0.05, 0.5):
        add(NOISE, "hum", (f"{size:g} N·m", {"readings": changed(torque=_hum(size))}))
    for step in (0.05, 0.2, 1.0):
        add(MUST, "torque step", (f"{step:g} N·m", {"torque_step": step, "torque_noise": 0.0}))
    for step in (1e-3, 5e-3, 2e-2):
        add(MUST, "angle step", (f"{step:g} rad", {"angle_step": step}))
    for slope in (0.002, 0.02):
        add(NOISE, "drift", (f"{slope:g} N·m/s", {"readings": changed(torque=_drift(slope))}))
    for gain in (0.1, 0.3, 1.0):
        for delay in (0.03, 0.04, 0.06):
            label = f"{gain:g}, {delay * 1e3:g} ms"
            add(MUST, "reflex", (label, {"reflex": gain, "reflex_delay": delay}))
    for hiding in (0.0, 0.3):
        for share in (0.3, 0.8):
            spread: dict[str, Any] = {"reflex": 0.2, "reflex_spread": share, "voluntary": hiding}
            add(MUST, "reflex of both joints", (f"{share:g}, {hiding:g} N·m", spread))
        for length in (5.0, 20.0):
            long: dict[str, Any] = {"reflex": 0.1, "reflex_length": length, "voluntary": hiding}
            add(MUST, "reflex by angle", (f"{length:g}, {hiding:g} N·m", long))
        hurried: dict[str, Any] = {"reflex": 0.1, "reflex_length": 5.0, "reflex_delay": 0.03}
        hurried |= {"cutoff": 6.0, "voluntary": hiding}
        add(MUST, "reflex beside slow noise", (f"{hiding:g} N·m", hurried))
    for stiff in (1e5, 3e4, 1e4, 3e3, 1e3):
        add(MUST, "cuff", (f"{stiff / 1e3:g} kN·m/rad", {"cuff": stiff}))
    for hiding in (0.0, 0.3):
        for gap in (1e-4, 1e-3, 5e-3):
            loosely: dict[str, Any] = {"cuff": 1e4, "loose": gap, "voluntary": hiding}
            add(MUST, "loose cuff", (f"{gap:g} rad, {hiding:g} N·m", loosely))
    for gap in (3e-3, 1e-2, 2e-2):
        # A multisine with all lines leaves only these lines themselves to show the play.
        play: dict[str, Any] = {"cuff": 1e3, "loose": gap, "voluntary": 0.2, "duration": 30.0}
        add(MUST, "loose cuff, multisine", (f"{gap:g} rad", {"waveform": "multisine", **play}))
    for waveform, hiding in product(("noise", "multisine", "binary"), (0.5, 1.0)):
        floats: dict[str, Any] = {"cuff": 300.0, "loose": 0.03, "voluntary": hiding}
        floats |= {"waveform": waveform, "duration": 30.0}
        add(MUST, "floating in loose cuffs", (f"{waveform}, {hiding:g} N·m", floats))
    for stiff in (3e5, 1e5):
        softly: dict[str, Any] = {"cuff": stiff, "voluntary": 0.3}
        add(MUST, "cuff, voluntary 0.3 N·m", (f"{stiff / 1e3:g} kN·m/rad", softly))
    for extra in (1.0, 5.0, 20.0):
        add(MUST, "short-range stiffness", (f"{extra:g}", {"short_range": extra}))
        hidden: dict[str, Any] = {"short_range": extra, "voluntary": 0.3}
        add(MUST, "short-range stiffness, voluntary 0.3 N·m", (f"{extra:g}", hidden))
    for share in (0.03, 0.1, 0.3):
        add(MUST, "stiffness of either direction", (f"{share:g}", {"one_sided": share}))
        add(MUST, "startled", (f"{share:g}", {"startled": share}))
        tense_alone: dict[str, Any] = {"tensed": 3.0 * share, "duration": 33.0}
        add(MUST, "tensed", (f"{3.0 * share:g}", tense_alone))
        for waveform in ("noise", "multisine"):
            tense: dict[str, Any] = {"startled": 3.0 * share, "tensed": 1.5 * share}
            tense["waveform"] = waveform
            add(MUST, f"startled and tensed, {waveform}", (f"{share:g}", tense))
        add(MUST, "amplitude-dependent", (f"{share:g}", {"cubic": share}))
        bent = {"cubic": share, "voluntary": 0.3}
        add(MUST, "amplitude-dependent, voluntary 0.3 N·m", (f"{share:g}", bent))
        add(MUST, "waxing stiffness", (f"{share:g}", {"waxing": share}))
        for name in ("coupled", "stiffness_by_speed", "damping_by_speed", "damping_by_angle"):
            for hiding in (0.0, 0.3):
                falls = name.endswith("speed")
                changing = {name: -share if falls else share, "voluntary": hiding}
                add(MUST, f"{name.replace('_', ' ')}, {share:g}", (f"{hiding:g} N·m", changing))
    for size in (0.1, 0.3, 1.0):
        add(NOISE, "tremor", (f"{size:g} N·m", {"tremor": size}))
        add(NOISE, "voluntary", (f"{size:g} N·m", {"voluntary": size}))
        add(NOISE, "rhythm", (f"{size:g} N·m", {"rhythm": size}))
        periodic = {"rhythm": size, "waveform": "multisine"}
        add(NOISE, "rhythm beside a multisine", (f"{size:g} N·m", periodic))
    for lock in (15.0, 30.0):
        add(NOISE, "soft lock", (f"{lock:g} rad/s", {"lock": lock}))
    for name in ("stiffness", "damping", "inertia"):
        for factor in (0.3, 3.0, 8.0):
            add(NOISE, f"{name} x", (f"{factor:g}", {name: factor}))
    add(NOISE, "preload", ("0.1 rad", {"preload": 0.1}))
    for sideways in (-0.3, 0.3):
        pressed = {"preload": sideways, "voluntary": 0.3}
        add(NOISE, "preload, voluntary 0.3 N·m", (f"{sideways:g} rad", pressed))
    for size in (0.5, 1.0):
        brief: dict[str, Any] = {"duration": 20.0, "voluntary": size, "level": 0.4}
        add(NOISE, "short trial", (f"{size:g} N·m", brief))
    # Readings lead where the law responds to the steps of a coarse encoder.
    for share, lock in product((0.2, 0.5, 1.0), (10.0, 25.0)):
        tenser: dict[str, Any] = {"tenser": share, "lock": lock, "voluntary": 0.05}
        label = f"{share:g}, {lock:g} rad/s"
        add(
            MUST,
            "tenser in one trial",
            (label, tenser),
            (f"{label}, 0.3 N·m", tenser | {"voluntary": 0.3}),
        )
    coarse: dict[str, Any] = {"angle_step": 1.6e-4, "lock": 80.0, "level": 0.5}
    for size in (0.1, 0.5):
        add(NOISE, "leading readings", (f"{size:g} N·m", coarse | {"voluntary": size}))
    for level in (0.2, 0.5):
        add(NOISE, "weak", (f"{level:g}", {"level": level}))
    for friction in (0.5, 1.0, 2.0):
        add(NOISE, "friction", (f"{friction:g} N·m", {"friction": friction}))
        pushed: dict[str, Any] = {"waveform": "binary", "cutoff": 15.0, "friction": 1.5 * friction}
        add(MUST, "friction, binary", (f"{1.5 * friction:g} N·m", pushed | {"stick": 0.01}))
    for friction, step in ((0.5, 5e-4), (1.0, 6e-5), (1.0, 5e-4), (2.0, 6e-5)):
        # Joints come to rest, as the law knows nothing of friction and the encoder is coarse.
        sticky = {"friction": friction, "stick": 0.005 * friction, "angle_step": step}
        kind = NOISE if friction < 2.0 else MUST
        add(kind, "sticking", (f"{friction:g} N·m, {step:g} rad", sticky))
    for friction in (0.7, 1.0):
        # The distortion by friction isn't independent of voluntary motion at the same time.
        beside = {"friction": friction, "stick": 0.005, "voluntary": 0.3}
        add(NOISE, "sticking, voluntary", (f"{friction:g} N·m", beside))
    for waveform, size in product(("noise", "multisine"), (0.05, 0.3)):
        links: dict[str, Any] = {"waveform": waveform, "voluntary": size, "level": 3.0}
        add(NOISE, f"two links, {waveform}", (f"{size:g} N·m", links | {"readings": _links}))
    for size in (0.2, 0.6):
        add(MUST, "noise in bursts", (f"{size:g} N·m", {"readings": _bursts(size)}))
    for draw, joints in product(range(3), (2, 3)):
        inexact: dict[str, Any] = {"joints": joints, "friction": 0.0}
        inexact["readings"] = _within_calibration(draw)
        add(NOISE, f"sensors as assumed, {joints} joints", (f"{draw}", inexact | undeclared))
    for factor in (0.92, 1.08):
        behind: dict[str, Any] = {"drive_lag": 2.0 * MILLI, "friction": 0.0, "lock": 60.0}
        behind |= {"voluntary": 0.3}
        behind["readings"] = changed(torque=_of_row(0, _times(factor)))
        add(MUST, "torque gain behind slow drives, declared", (f"{factor:g}", behind))
    three = {"joints": 3}
    for factor in (0.102, 0.5):
        hidden_gain = three | {"readings": changed(torque=_times(factor)), "voluntary": 0.3}
        add(
            MUST,
            "torque gain, three joints, voluntary 0.3 N·m",
            (f"{factor:g}", hidden_gain | undeclared),
        )
    add(NOISE, "three joints", ("", three), ("800", three | {"rate": 800.0}))
    add(
        MUST,
        "three joints, gain of joint 2",
        ("0.9", three | {"readings": changed(torque=_of_row(1, _times(0.9)))}),
    )
    # Encoders so fine that commands hardly chatter, so readings show no jumps along with them.
    fine = {"angle_step": 1e-5, "friction": 0.15, "stick": 4e-3, "voluntary": 0.05}
    for rate in (500.0, 1000.0, 2000.0):
        for joints in (1, 2, 3):
            steady = fine | {"joints": joints, "rate": rate}
            add(NOISE, "fine angles", (f"{joints} joints, {rate:g}", steady))
            weak = steady | {"level": 0.4, "friction": 0.4, "angle_step": 6e-5, "lock": 60.0}
            if joints < 3:  # a wrist does not move then
                add(NOISE, "friction and a weak perturbation", (f"{joints} joints, {rate:g}", weak))
    for inertia in (0.3, 3.0):
        add(NOISE, "robot x", (f"{inertia:g}", {"robot": inertia}))
        for factor in (0.9, 0.95, 1.1):
            light = {
                "robot": inertia,
                "readings": changed(torque=_of_row(1, _times(factor))),
            } | undeclared
            add(MUST, "robot and torque gain of joint 2", (f"{inertia:g}, {factor:g}", light))
    add(
        NOISE,
        "multisine",
        ("", {"waveform": "multisine"}),
        ("2000", {"waveform": "multisine", "rate": 2000.0}),
        ("weak", {"waveform": "multisine", "level": 0.2}),
        ("friction 2 N·m", {"waveform": "multisine", "friction": 2.0}),
    )
    for share in (0.1, 0.3):
        for size in (0.0, 0.3):
            hidden = {"waveform": "multisine", "cubic": share, "voluntary": size}
            add(MUST, "bent, multisine", (f"{share:g}, {size:g} N·m", hidden))
    for waveform in ("sines 12", "sines 20", "sines 40", "chirp", "sweep", "binary"):
        # In much of the band there is no perturbation except its leakage.
        for size in (0.0, 0.1, 0.3, 1.0):
            sparse: dict[str, Any] = {"waveform": waveform, "voluntary": size}
            add(MUST, waveform, (f"{size:g} N·m", sparse | {"cutoff": 15.0}))
    for count, size in ((8, 0.3), (12, 0.0), (15, 0.0), (15, 0.3)):
        few = {"waveform": f"sines {count}", "voluntary": size, "cutoff": 15.0}
        add(NOISE, "few sines", (f"{count}, {size:g} N·m", few))
    for size, stiff in ((0.2, 500.0), (0.5, 2000.0), (1.0, 1e4)):
        add(
            NOISE,
            "bristles",
            (f"{size:g} N·m, {stiff:g} N·m/rad", {"friction": size, "bristle": stiff}),
        )
    for size in (0.05, 0.2):
        add(NOISE, "cogging", (f"{size:g} N·m", {"cogging": size}))
    for gap in (0.01, 0.05, 0.2):
        rubbed = changed(torque=_backlash(gap))
        add(MUST, "torque hysteresis", (f"{gap:g} N·m", {"readings": rubbed}))
        unseen: dict[str, Any] = {"readings": rubbed, "voluntary": 0.3}
        add(MUST, "torque hysteresis, voluntary 0.3 N·m", (f"{gap:g} N·m", unseen))
    for rub in (0.005, 0.02, 0.1):
        add(MUST, "friction of the arm", (f"{rub:g} N·m", {"rubbing": rub}))
        moved: dict[str, Any] = {"rubbing": rub, "voluntary": 0.3}
        add(MUST, "friction of the arm, voluntary 0.3 N·m", (f"{rub:g} N·m", moved))
    for zone in (0.005, 0.02, 0.1):
        for name, less in (("torque dead zone", True), ("torque dead zone that jumps", False)):
            dead: dict[str, Any] = {"readings": changed(torque=_dead(zone, less=less))}
            add(MUST, name, (f"{zone:g} N·m", dead))
            add(MUST, f"{name}, voluntary 0.3 N·m", (f"{zone:g} N·m", dead | {"voluntary": 0.3}))
    for share in (0.0005, 0.002, 0.01):
        for name in ("zero", "held", "spike"):
            lost: dict[str, Any] = {"readings": changed(torque=_lost(share, name))}
            add(MUST, f"torque samples lost, {name}", (f"{share:g}", lost))
            beside = lost | {"voluntary": 0.3}
            add(MUST, f"torque samples lost, {name}, voluntary 0.3 N·m", (f"{share:g}", beside))
    for samples in (3, 5, 9):
        smooth_one = {"voluntary": 0.3, "readings": changed(torque=_median(samples))}
        add(MUST, "torque median, voluntary 0.3 N·m", (f"{samples}", smooth_one))
    for rate in (50.0, 100.0, 250.0):
        slow_one = {"voluntary": 0.3, "readings": changed(torque=_slower(rate))}
        add(MUST, "torque of a lower rate, voluntary 0.3 N·m", (f"{rate:g} Hz", slow_one))
    for name, order, (share, lost_for) in product(
        ("position", "torque"), (1, 3), ((0.2, 2.0), (0.3, 1.0))
    ):
        bridge = changed(**{name: _bridged(share, lost_for, order)})
        label = f"{share:g}, {lost_for:g} s"
        gaps = {"voluntary": 0.3, "readings": bridge}
        add(MUST, f"{name} bridged by splines of order {order}, voluntary 0.3 N·m", (label, gaps))
    for share in (0.1, 0.3, 0.5):
        for counts in (4, 16):
            steps = {"readings": changed(position=_uneven_counts(share, counts))}
            add(MUST, "encoder counts uneven", (f"{share:g}, {counts}", steps))
    for gap in (1e-4, 1e-3, 5e-3):
        loose = changed(position=_backlash(gap))
        add(MUST, "angle backlash", (f"{gap:g} rad", {"readings": loose}))
    for share in (0.03, 0.1, 0.3):
        uneven = {"readings": changed(torque=_uneven(share))}
        add(MUST, "torque larger in one direction", (f"{share:g}", uneven))
        compressed: dict[str, Any] = {"readings": changed(torque=_yielding(share))}
        add(MUST, "torque compressed", (f"{share:g}", compressed))
        periodic = compressed | {"waveform": "multisine"}
        add(MUST, "torque compressed, multisine", (f"{share:g}", periodic))
    for wave, joints, slow in product(("binary", "steps"), (1, 2), (0.0, 0.1)):
        for name, bend in (("compressed", _yielding(0.1)), ("uneven", _uneven(0.1))):
            two: dict[str, Any] = {"waveform": wave, "joints": joints, "voluntary": slow}
            two["readings"] = _then_without_commands(changed(torque=bend))
            add(MUST, f"two torques, {name}", (f"{wave}, {joints} joints, {slow:g} N·m", two))
    for name, size, spoil in (
        *(
            ("encoder that saturates", one, changed(position=_saturating(one)))
            for one in (0.1, 0.2, 0.4)
        ),
        *(
            ("angle larger in one direction", one, changed(position=_one_way(one)))
            for one in (0.02, 0.1, 0.3)
        ),
        *(("gain by speed", one, _faster(one)) for one in (0.03, 0.1, 0.3)),
    ):
        for wave, slow in product(("noise", "multisine"), (0.0, 0.3)):
            spoilt: dict[str, Any] = {"readings": spoil, "waveform": wave, "voluntary": slow}
            add(MUST, f"{name}, {wave}, {slow:g} N·m", (f"{size:g}", spoilt))
    for share in (0.02, 0.1):
        add(
            MUST,
            "gain that drifts",
            (f"{share:g}", {"readings": changed(torque=_ramped(share, 0.5, -0.5))}),
        )
    for share in (0.02, 0.1, 0.3):
        stepped = {"readings": changed(torque=_stepped(share))}
        add(MUST, "gain that changes at once", (f"{share:g}", stepped))
    for share, slow in product((0.03, 0.1, 0.2), (0.0, 0.3)):
        back = {"voluntary": slow, "readings": changed(torque=_returning(share))}
        add(MUST, "gain that comes back", (f"{share:g}, {slow:g} N·m", back))
    for share, frequency, slow in product((0.03, 0.1), (2.5, 4.0), (0.0, 0.1, 0.3)):
        swinging = {"hand": share, "hand_frequency": frequency, "voluntary": slow}
        add(MUST, "hand that swings", (f"{share:g}, {frequency:g} Hz, {slow:g} N·m", swinging))
    for frequency in (12.0, 18.0):
        tissue: dict[str, Any] = {"hand": 0.2, "hand_frequency": frequency, "hand_damping": 0.8}
        add(MUST, "soft tissue", (f"{frequency:g} Hz", tissue | {"voluntary": 0.3}))
    for slow in (0.05, 0.3):
        rests: dict[str, Any] = {"waveform": "multisine", "pause": 5.0, "voluntary": slow}
        add(NOISE, "multisine, then rest", (f"{slow:g} N·m", rests))
    tapped = {"waveform": "taps", "readings": _without_commands}
    add(MUST, "taps without commands", ("", tapped), ("0.3 N·m", tapped | {"voluntary": 0.3}))
    for share, push in product((0.0, 0.1, 0.2), (0.0, 0.03)):
        swept = {"waveform": "sweep 51", "waxing": share, "voluntary": push}
        add(MUST if share else NOISE, "single sweep, waxing", (f"{share:g}, {push:g} N·m", swept))
    for share, time, push in product((0.03, 0.06), (0.05, 0.3), (0.1, 0.3)):
        creeps = {"voluntary": push, "readings": changed(torque=_creeping(share, time))}
        label = f"{share:g}, {time:g} s, {push:g} N·m"
        add(MUST, "creep, calibrated with weights", (label, creeps))
    for lock, push in product((60.0, 150.0), (0.05, 0.3)):
        held = {"lock": lock, "voluntary": push, "readings": _perturbed_alone}
        add(MUST, "locked angles unrecorded", (f"{lock:g} rad/s, {push:g} N·m", held))
    for push in (0.05, 0.3):
        add(NOISE, "brakes", (f"{push:g} N·m", {"voluntary": push, "readings": _braked}))
    for lock, friction in product((60.0, 250.0), (0.1, 0.3)):
        resting: dict[str, Any] = {"waveform": "binary", "rate": 2000.0, "duration": 40.0}
        resting |= {"bristle": 1500.0, "viscosity": 0.05, "angle_step": 3e-5, "voluntary": 0.1}
        resting |= {"lock": lock, "friction": friction}
        add(
            NOISE,
            "friction that holds between pushes",
            (f"{friction:g} N·m, {lock:g} rad/s", resting),
        )
    for waveform in ("sweep 51", "sweep 26", "noise", "multisine", "steps"):
        add(NOISE, "quick movements", (waveform, {"waveform": waveform, "twitches": 2.0}))
    for seconds in (4.0, 8.0):
        brief = {"duration": seconds, "voluntary": 0.05}
        label = f"{seconds:g} s"
        add(NOISE, "short", (label, brief))
        add(MUST, "short, friction of the arm", (label, brief | {"rubbing": 0.1}))
        for name, bending in (("larger in one direction", _uneven), ("compressed", _yielding)):
            spoilt = brief | {"readings": changed(torque=bending(0.2))}
            add(MUST, f"short, torque {name}", (label, spoilt))
    for friction in (0.0, 0.15):
        add(NOISE, "steps", (f"{friction:g} N·m", {"waveform": "steps", "friction": friction}))
    for share in (0.02, 0.05, 0.1):
        ramped = {"readings": changed(torque=_ramped(share))}
        add(MUST, "gain that grows", (f"{share:g}", ramped))
    blended = {
        "rate": 800.0,
        "command_delay": 0.4 * MILLI,
        "friction": 0.5,
        "torque_delay": 0.7 * MILLI,
    }
    add(MUST, "mixed", ("late", blended), ("late, bristles", blended | {"bristle": 1500.0}))
    hummed = {
        "voluntary": 0.3,
        "cogging": 0.05,
        "readings": changed(torque=_hum(0.1)),
        "waveform": "multisine",
    }
    add(NOISE, "mixed", ("hum, voluntary, cogging", hummed))
    add(MUST, "mixed", ("reflex, cuff", {"reflex": 0.2, "cuff": 2e4}))
    for share in (0.03, 0.1, 0.3):
        shaky = _unsteady(share)
        both = changed(position=shaky, torque=shaky)
        add(MUST, "instants jitter", (f"{share:g} periods", {"readings": both}))
    for share, (times, name) in product((0.003, 0.01, 0.05), ((0, "lost"), (2, "recorded twice"))):
        for waveform in ("noise", "multisine"):
            whole: dict[str, Any] = {"waveform": waveform, "readings": _recorded(share, times)}
            add(MUST, f"whole samples {name}, {waveform}", (f"{share:g}", whole))
    for size, poles in ((1e-3, 1.0), (5e-3, 1.0), (2e-4, 50.0), (1e-3, 50.0)):
        eccentric: dict[str, Any] = {"readings": changed(position=_bent(size, poles))}
        # A user who knows the size of such errors, but not their place, declares this.
        eccentric["scale"] = size * poles / np.sqrt(2.0)
        add(MUST, "encoder not round", (f"{size:g} rad, {poles:g}", eccentric))
    for factor in (0.8, 0.9, 1.1):
        add(MUST, "command gain", (f"{factor:g}", {"readings": changed(command=_times(factor))}))
        one_drive = changed(command=_of_row(1, _times(factor)))
        add(MUST, "command gain of joint 2", (f"{factor:g}", {"readings": one_drive}))
        for row, hiding in product((0, 1), (0.0, 0.3)):
            scale = changed(position=_of_row(row, _times(factor)))
            about: dict[str, Any] = {"voluntary": hiding, "readings": scale}
            add(MUST, f"scale of encoder {row + 1}, {factor:g}", (f"{hiding:g} N·m", about))
    for row in (0, 1):
        turned = changed(position=_of_row(row, _times(-1.0)), torque=_of_row(row, _times(-1.0)))
        add(MUST, "sign of angle and torque of joint", (f"{row + 1}", {"readings": turned}))
    for late in (0.3, 1.0, 3.0):
        for name in ("torque", "position"):
            one_late = changed(**{name: _of_row(1, _late(late))})
            add(MUST, f"{name} of joint 2 late", (f"{late:g} ms", {"readings": one_late}))
            add(
                MUST,
                f"{name} of joint 2 late, voluntary 0.3 N·m",
                (f"{late:g} ms", {"readings": one_late, "voluntary": 0.3}),
            )
    for rate in (500.0, 800.0, 2000.0):
        add(MUST, "interpolated", (f"{rate:g}", {"readings": _resampled(rate)}))
    for name, change in (
        ("gain 0.8", _times(0.8)),
        ("offset 1 N·m", lambda values: values + 1.0),
        ("late 1 ms", _late(1.0)),
        ("late 5 ms", _late(5.0)),
    ):
        add(MUST, "perturbation", (name, {"readings": changed(perturbation=change)}))
    add(
        MUST,
        "synchronous voluntary",
        ("", {"waveform": "multisine", "voluntary": 0.3, "synchronous": True}),
    )
    for lean in (0.5, 2.0):
        add(NOISE, "posture drifts", (f"{lean:g} N·m", {"leaning": lean}))
    for share in (0.5, 0.9):
        add(NOISE, "uneven stiffness", (f"{share:g}", {"asymmetry": share}))
    add(MUST, "very weak", ("0.03", {"level": 0.03}))
    for seconds in (3.0, 5.0, 10.0, 20.0):
        add(MUST, "short trial", (f"{seconds:g} s", {"duration": seconds}))
    for edge in (3.0, 6.0, 10.0):
        add(MUST, "narrow perturbation", (f"{edge:g} Hz", {"cutoff": edge}))
    for hiding in (0.3, 1.0):
        for arc in (0.08, 0.2):
            noisy: dict[str, Any] = {"reflex": arc, "voluntary": hiding, "tremor": 0.1 * hiding}
            add(MUST, "reflex under voluntary", (f"{arc:g}, {hiding:g} N·m", noisy))
        for time in (0.05, 0.3):
            muscle: dict[str, Any] = {"relaxing": 2.0, "relaxation": time, "voluntary": hiding}
            add(MUST, "relaxation under voluntary", (f"{time:g} s, {hiding:g} N·m", muscle))
    for push in (0.3, 1.0):
        for name, change in (
            ("torque larger in one direction", _uneven(0.1)),
            ("gain that grows", _ramped(0.05)),
        ):
            shifted: dict[str, Any] = {"voluntary": push, "readings": changed(torque=change)}
            add(MUST, f"{name}, voluntary", (f"{push:g} N·m", shifted))
    restless: dict[str, Any] = {"voluntary": 1.0, "tremor": 0.1, "duration": 30.0}
    add(NOISE, "voluntary and tremor", ("1 N·m", restless))
    for slow in (0.5, 1.0, 2.0):
        for rub in (0.1, 1.0, 2.0):
            lagging: dict[str, Any] = {"drive_lag": slow * MILLI, "friction": rub, "level": 2.0}
            lagging |= {"stick": 2e-3, "bristle": 2e3, "lock": 80.0}
            add(MUST, "drive lag", (f"{slow:g} ms, friction {rub:g} N·m", lagging))
    rubbing: dict[str, Any] = {"friction": 1.0, "stick": 2e-3, "bristle": 2e3, "drive_lag": 5e-4}
    rubbing |= undeclared | {"level": 2.0}
    for factor in (0.8, 0.9, 1.1, 1.3):
        scaled = {"readings": changed(torque=_times(factor))} | rubbing
        add(MUST, "friction and lag, torque gain", (f"{factor:g}", scaled))
    summed = {"readings": changed(position=lambda values: np.cumsum(values, axis=0))}
    add(MUST, "absolute angles", ("", summed), ("with friction and lag", summed | rubbing))
    for share in (0.01, 0.02, 0.03, 0.1):
        crossed = {"readings": changed(torque=_cross(share))} | undeclared
        add(MUST, "cross-talk", (f"{100 * share:g} %", crossed))
    for share, name in product((-0.1, 0.1, 0.3), ("torque", "position")):
        mixed = {"readings": changed(**{name: _mixed(share)})} | undeclared
        add(MUST, f"{name} of the next joint", (f"{100 * share:g} %", mixed))
    for loss, slow in product((0.02, 0.05, 0.1), (0.0, 0.3)):
        lossy = {"readings": _efficiency(loss), "voluntary": slow} | undeclared
        add(MUST, f"losses, voluntary {slow:g} N·m", (f"{100 * loss:g} %", lossy))
    for stiffness in (-2.0, -0.5, 0.1, 0.5, 2.0):
        add(MUST, "cable", (f"{stiffness:g} N·m/rad", {"readings": _cable(stiffness)} | undeclared))
    return found


def _clip(share: float) -> Change:
    def clip(values: FloatArray) -> FloatArray:
        low = np.quantile(values, share / 2, axis=1, keepdims=True)
        high = np.quantile(values, 1 - share / 2, axis=1, keepdims=True)
        return np.clip(values, low, high)

    return clip


def streams_of(recordings: list[Recording]) -> Streams:
    """Join trials one after the other into streams, as if decoded from a bag."""
    gap = 2_000_000_000
    stamps, shift = [], 0
    for one in recordings:
        stamps.append(one.stamps + shift)
        shift = int(stamps[-1][-1] - one.stamps[0] + gap)
    joined = np.concatenate(stamps)
    fields = {
        topics.JOINT_STATES: "position",
        topics.TORQUE_SENSORS: "torque",
        topics.PERTURBATION: "perturbation",
    }
    streams = Streams(NAMES[: len(recordings)])
    for topic, name in fields.items():
        values = np.concatenate([getattr(one, name) for one in recordings], axis=1)
        streams.stamped[topic].append(joined, values)
    if all(one.command is not None for one in recordings):
        commands = np.concatenate([one.command for one in recordings], axis=1)
        commands = commands[:, recordings[0].command_shift :]
        streams.commands.append(np.zeros(commands.shape[1], np.int64), commands)
    return streams


def verdict_on(
    recordings: list[Recording], *, calibrated: bool = True, scale: float = 0.0
) -> Result:
    """Estimate from trials without trial status; `calibrated` declares the transducers exact.

    `scale`, the standard error of the encoders' scale, is declared if they are, or if it isn't 0.
    """
    trials = assemble_trials(streams_of(recordings), ())
    metadata = dict.fromkeys(CALIBRATION_KEYS, "0") if calibrated else {}
    metadata.pop("linearity_uncertainty", None)  # no laboratory knows it to be zero
    # Other models of the arm are no part of the verdict on M, B and K.
    metadata["arm_model"] = '"mbk"'
    if calibrated or scale:
        metadata["angle_uncertainty"] = str(scale)
    names = NAMES[: len(recordings)]
    return conclude(
        trials, known=Metadata.of(metadata), joint_names=names, estimators=("lpm_full",)
    )


def outcome(mismatch: Mismatch, seed: int) -> Outcome:
    """Valid or not; worst error in standard errors, and in per cent; problems."""
    try:
        recordings, known = simulate(mismatch, seed), mismatch.calibrated
        summary = verdict_on(recordings, calibrated=known, scale=mismatch.scale).summary
    except ArmimpError as error:
        return False, np.nan, np.nan, [str(error)]
    if "lpm_full" not in summary.estimators:
        return False, np.nan, np.nan, [str(one) for one in summary.problems]
    found = summary.estimators["lpm_full"]
    worst, relative = 0.0, 0.0
    for name, truth in zip("MBK", arm_of(mismatch), strict=True):
        off = np.abs(np.array(getattr(found, name)) - truth)
        worst = max(worst, float(np.max(off / np.array(getattr(found, f"{name}_se")))))
        relative = max(relative, float(np.max(off / np.abs(truth))))
    return summary.valid, worst, 100 * relative, [str(one) for one in summary.problems]


def _outcomes(names: Sequence[str], seed: int) -> list[Outcome]:
    """Outcomes of classes that share a simulation, for one seed."""
    known = cases()
    return [outcome(known[name][1], seed) for name in names]


def outcomes_of(
    names: Sequence[str], seeds: Sequence[int], workers: int | None
) -> list[list[Outcome]]:
    """Outcomes by class and seed, with one simulation for all classes that share it."""
    known, groups = cases(), dict[Mismatch, list[str]]()
    for name in names:
        groups.setdefault(known[name][1].simulated, []).append(name)
    tasks = [(group, seed) for seed in seeds for group in groups.values()]
    found: dict[str, list[Outcome]] = {name: [] for name in names}
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        for (group, _), outcomes in zip(
            tasks, pool.map(_outcomes, *zip(*tasks, strict=True)), strict=True
        ):
            for name, one in zip(group, outcomes, strict=True):
                found[name].append(one)
    return [found[name] for name in names]


def judge(name: str, outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Return a row of the table: one class at one magnitude, over all seeds."""
    kind = cases()[name][0]
    valid = sum(one[0] for one in outcomes)
    return {
        "class": name,
        "kind": kind,
        "runs": len(outcomes),
        "valid": valid,
        "false_valid": sum(one[0] and not one[1] <= LIMIT for one in outcomes),
        "false_refusals": len(outcomes) - valid if kind == NOISE else 0,
        "worst_in_errors": np.nanmax([0.0, *(one[1] for one in outcomes)]),
        "worst_percent": np.nanmax([0.0, *(one[2] for one in outcomes)]),
        "reason": next((one[3][0] for one in outcomes if one[3]), ""),
    }


def investigate(options: InvestigationOptions) -> int:
    """Judge every class of mismatch, write ``truth.*`` and print the table.

    Returns
    -------
    int
        Exit status 0, whatever the table says: this is a measurement.

    Raises
    ------
    ConfigurationError
        If no class has the name that was asked for.
    """
    chosen = options.seeds or "0:4"
    seeds = parse_seeds(chosen)
    names = names_like(options.only)
    found = outcomes_of(names, seeds, options.workers)
    rows = [judge(name, outcomes) for name, outcomes in zip(names, found, strict=True)]
    title = f"recordings of a rig that isn't the project's, {len(seeds)} seeds"
    tabulate(options, "truth", title, chosen, rows)
    return 0


def names_like(pattern: str) -> list[str]:
    """Names of the classes that match a pattern.

    Raises
    ------
    ConfigurationError
        If none does.
    """
    names = [name for name in cases() if re.search(pattern, name)]
    if not names:
        raise ConfigurationError(f"--only {pattern}: no class is of that name")
    return names


def tabulate(
    options: InvestigationOptions, name: str, title: str, seeds: str, rows: Sequence[dict[str, Any]]
) -> None:
    """Write the rows of a study with their totals, and print them."""
    counted = ("runs", "false_valid", "false_refusals")
    totals = {key: sum(row[key] for row in rows) for key in counted}
    result = {"schema": 1, "seeds": seeds, **totals, "classes": list(rows)}
    write_tables(options.out, name, result, rows)
    display().close()
    if options.json:
        print(to_json(result))
        return
    shown = ("valid", "false_valid", "false_refusals")
    print_table(
        title,
        ("class", "kind", *shown, "worst/s.e.", "worst %", "reason"),
        [
            (
                row["class"],
                row["kind"],
                *(str(row[key]) for key in shown),
                f"{row['worst_in_errors']:.3g}",
                f"{row['worst_percent']:.3g}",
                row["reason"][:70],
            )
            for row in rows
        ],
        ", ".join(f"{key.replace('_', ' ')}: {value}" for key, value in totals.items()),
    )
