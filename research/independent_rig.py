"""A rig that shares no code with the project's own, to judge the estimator's verdicts.

Arm and robot are one linear state-space model, integrated exactly over 20 steps in each control
period, with forces that are held over a step (friction of the robot, reflex, muscle that depends
on amplitude or time). The controller is a plain PD law on differentiated encoder readings and does
not use the torque. Each class of mismatch is an option of :class:`Mismatch`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.ndimage import gaussian_filter1d
from scipy.signal import butter, sosfilt

FloatArray = NDArray[np.float64]

SUBSTEPS = 20
# Of the arm: kg·m², N·m·s/rad, N·m/rad; inertia of the robot, kg·m²; posture, rad.
INERTIA = np.array([[0.187, 0.084, 0.008], [0.079, 0.060, 0.006], [0.008, 0.006, 0.005]])
DAMPING = np.array([[0.651, 0.239, 0.03], [0.236, 0.407, 0.04], [0.03, 0.04, 0.09]])
STIFFNESS = np.array([[7.967, 3.187, 0.4], [1.663, 6.901, 0.6], [0.3, 0.5, 1.8]])
ROBOT = np.array([[0.41, 0.17, 0.015], [0.17, 0.15, 0.012], [0.015, 0.012, 0.011]])
POSTURE = np.array([1.1, 1.35, 0.2])
PUSH = (2.5, 1.5, 0.3)
"""Standard deviations of the perturbations, N·m."""
RATCHET = 120.0
"""Periods of the cogging per turn."""
BRISTLE = 1e-4
"""Largest deflection of the bristles between transducers and arm, rad."""
NAMES = ("shoulder", "elbow", "wrist")


@dataclass(frozen=True, kw_only=True)
class Mismatch:
    """How rig, arm and recording deviate from the ideal; SI units, times in s."""

    joints: int = 2
    """How many of shoulder, elbow and wrist."""
    robot: float = 1.0
    """Inertia of the robot, times the value above."""
    waveform: str = "noise"
    """Waveform of the perturbation: see :func:`_perturbation`."""
    rate: float = 1000.0
    duration: float = 50.0
    pause: float = 0.0
    """Time at the end of each trial without a perturbation, s."""
    level: float = 1.0
    """Size of the perturbation: 1 gives standard deviations of 2.5, 1.5 and 0.3 N·m."""
    inertia: float = 1.0
    damping: float = 1.0
    stiffness: float = 1.0
    """Properties of the arm, times the values above."""
    torque_delay: float = 0.0
    """Delay of torque readings against the instant just before the update."""
    after: bool = False
    mean: bool = False
    low_pass: float = 0.0
    """Time constant of the torque readings."""
    angle_low_pass: float = 0.0
    command_delay: float = 0.0
    drive_lag: float = 0.0
    """Time constant with which the torques of the drives follow their commands."""
    torque_noise: float = 0.003
    angle_step: float = 6.136e-5
    torque_step: float = 0.01
    friction: float = 0.15
    stick: float = 0.02
    """Speed at which friction reaches three quarters of its size, rad/s; small: joints can rest."""
    bristle: float = 0.0
    """Stiffness of joints that friction holds, N·m/rad (LuGre); 0: friction by speed alone."""
    cogging: float = 0.0
    """Amplitude of the cogging torque of the motors, N·m."""
    viscosity: float = 0.1
    lock: float = 150.0
    """Natural frequency of locked joints, rad/s (at most a sixth of the rate)."""
    cuff: float = 0.0
    """Stiffness between robot and arm, N·m/rad; 0: rigid."""
    hand: float = 0.0
    """Share of the arm's inertia that a spring couples to it, as of a hand that is not strapped;
    not beside a cuff."""
    hand_frequency: float = 3.0
    """Natural frequency of that with the arm at rest, Hz."""
    hand_damping: float = 0.4
    """Damping ratio of that."""
    loose: float = 0.0
    """Angle by which the robot moves freely before the cuff takes the arm along, either way."""
    reflex: float = 0.0
    reflex_delay: float = 0.04
    reflex_spread: float = 0.0
    """Share of each joint's reflex that acts on the others, as of muscles over two joints."""
    reflex_length: float = 0.0
    """Gain of the reflex to angle over that to speed, 1/s."""
    short_range: float = 0.0
    """Additional stiffness within 5 mrad of a yielding element, N·m/rad."""
    relaxing: float = 0.0
    """Additional stiffness that relaxes, N·m/rad."""
    relaxation: float = 0.3
    """Its time constant."""
    cubic: float = 0.0
    """Share by which the secant stiffness falls at 50 mrad."""
    coupled: float = 0.0
    """The same of the stiffness between joints alone, with the angle of the other joint."""
    stiffness_by_speed: float = 0.0
    damping_by_speed: float = 0.0
    """Shares by which stiffness and damping change at 0.5 rad/s; twice that far beyond it."""
    damping_by_angle: float = 0.0
    """Share by which damping grows at 50 mrad."""
    one_sided: float = 0.0
    """Share by which stiffness differs between the two directions."""
    startled: float = 0.0
    """Share by which stiffness is larger at first; its time constant is 1/15 of the trial."""
    tensed: float = 0.0
    """The same of damping."""
    tenser: float = 0.0
    """Share by which stiffness is larger while the last joint is perturbed; damping by the root."""
    waxing: float = 0.0
    """Share by which stiffness grows over the trial."""
    rubbing: float = 0.0
    """Friction between transducers and arm at each joint, N·m; its bristles bend by 0.1 mrad."""
    tremor: float = 0.0
    voluntary: float = 0.0
    rhythm: float = 0.0
    """Rms of a tremor, of slow voluntary torque, and of a rhythm of 1 Hz, N·m."""
    twitches: float = 0.0
    """Standard deviation of the peaks of quick movements of 80 ms, every 20 s on average, N·m."""
    synchronous: bool = False
    """Whether these torques repeat themselves every 10 s, as a multisine does."""
    leaning: float = 0.0
    """Torque that the person builds up over the trial, so that the posture drifts, N·m."""
    cutoff: float = 20.0
    """Cut-off of the perturbation, Hz."""
    asymmetry: float = 0.0
    """Share by which the stiffness grows above the diagonal, and falls below it."""
    preload: float = 0.0
    """Angle between the posture held and the arm's rest, rad."""
    calibrated: bool = True
    """Whether the transducers are declared exact."""
    scale: float = 0.0
    """Declared standard error of the encoders' scale."""
    readings: Callable[[Recording], Recording] | None = field(default=None, compare=False)
    """Change made to the recorded arrays afterwards."""

    @property
    def simulated(self) -> Mismatch:
        """The part of it that affects the simulation."""
        return replace(self, readings=None, calibrated=True, scale=0.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """One trial as a recorder would have it; arrays (n, N)."""

    joint: int
    stamps: NDArray[np.int64]
    position: FloatArray
    torque: FloatArray
    perturbation: FloatArray
    command: FloatArray | None
    command_shift: int = 0


def arm_of(
    mismatch: Mismatch, trial: int | None = None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return M, B and K of the arm at small amplitude: in one trial, or each column in its own."""
    n = mismatch.joints
    tension = 1.0 + mismatch.tenser * (np.arange(n) == n - 1)
    if trial is not None:
        tension = np.full(n, tension[trial])
    uneven = 1.0 + mismatch.asymmetry * (np.triu(np.ones((n, n)), 1) - np.tril(np.ones((n, n)), -1))
    return (
        INERTIA[:n, :n] * mismatch.inertia,
        DAMPING[:n, :n] * mismatch.damping * np.sqrt(tension),
        STIFFNESS[:n, :n] * mismatch.stiffness * uneven * tension,
    )


@njit(cache=True)
def _run(  # type: ignore[no-untyped-def] # noqa: C901, PLR0912, PLR0913, PLR0915, PLR0917 (a loop)
    A,
    G,
    torque_of,
    perturbation,
    disturbance,
    gains,
    target,
    pole,
    angle_step,
    angle_pole,
    friction,
    stick,
    bristle,
    cogging,
    reflex,
    reflex_steps,
    nonlinear,
    hold,
    step,
    substeps,
    command_steps,
    drive_pole,
    states,
    mean,
    torque_pole,
):
    """Run the loop; return angles, commands, torques before updates, and filtered ones by step."""
    n = len(perturbation)
    ticks = perturbation.shape[1]
    position = np.zeros((n, ticks))
    command = np.zeros((n, ticks))
    before = np.zeros((n, ticks))
    fine = np.zeros((n, ticks * substeps))
    x = np.zeros(states)
    new = np.zeros(states)
    force = np.zeros(2 * n)
    active = np.zeros(n)
    sent = np.zeros((n, 8))
    velocity = np.zeros(n)
    last = np.zeros(n)
    filtered = np.zeros(n)
    stretch = np.zeros((n, reflex_steps))
    oldest = 0
    contraction = np.zeros((n, 2))
    low = np.zeros(n)
    yielding = np.zeros(n)
    relaxed = np.zeros(n)
    bend = np.zeros(n)
    rubs = np.zeros(n)
    grip = np.zeros(n)
    slip = np.zeros(n)
    where = states - 2 * n if states > 2 * n else 0
    for k in range(ticks):
        for i in range(n):
            filtered[i] += angle_pole * (x[i] - filtered[i])
            reading = filtered[i] if angle_pole < 1.0 else x[i]
            if angle_step > 0.0:
                reading = np.round(reading / angle_step) * angle_step
            position[i, k] = reading
            velocity[i] += pole * ((reading - last[i]) - velocity[i]) if k else 0.0
            last[i] = reading
            command[i, k] = (
                perturbation[i, k] - gains[0, i] * (reading - target[i]) - gains[1, i] * velocity[i]
            )
            for age in range(7, 0, -1):
                sent[i, age] = sent[i, age - 1]
            sent[i, 0] = command[i, k]
        early = np.exp(-15.0 * k / ticks)
        for s in range(substeps):
            whole = 0
            left = s - command_steps
            while left < 0:
                left += substeps
                whole += 1
            for i in range(n):
                old = active[i]
                active[i] += drive_pole * (sent[i, whole] - active[i])
                speed = x[n + i]
                if bristle > 0.0:
                    # Bristles bend at the speed of the joint, until they carry all of the friction.
                    ease = bristle * abs(speed) / friction
                    ends = friction / bristle * np.sign(speed)
                    bend[i] = ends + (bend[i] - ends) * np.exp(-ease * step)
                    rubs[i] = bristle * bend[i]
                else:
                    rubs[i] = friction * np.tanh(speed / stick)
                if cogging > 0.0:
                    rubs[i] += cogging * np.sin(RATCHET * x[i])
                force[i] = old - rubs[i]
                q, v = x[where + i], x[where + n + i]
                # Reflex: torque after a delay, through two first-order lags of the muscle.
                contraction[i, 0] += hold * (reflex * stretch[i, oldest] - contraction[i, 0])
                stretch[i, oldest] = v + nonlinear[9] * q
                contraction[i, 1] += hold * (contraction[i, 0] - contraction[i, 1])
                # A spring of limited range that yields and follows.
                if q - yielding[i] > 0.005:
                    yielding[i] = q - 0.005
                if q - yielding[i] < -0.005:
                    yielding[i] = q + 0.005
                extra = nonlinear[0] * (q - yielding[i])
                relaxed[i] += nonlinear[4] * (q - relaxed[i])
                extra += nonlinear[3] * (q - relaxed[i])
                extra -= nonlinear[1] * q * min(q * q / 0.0025, 4.0)
                extra += nonlinear[2] * (k / ticks - 0.5) * q
                if nonlinear[7] > 0.0:
                    ends = BRISTLE * np.sign(v)
                    grip[i] = ends + (grip[i] - ends) * np.exp(-abs(v) / BRISTLE * step)
                    extra += nonlinear[7] * grip[i] / BRISTLE
                extra += nonlinear[5] * abs(q) + early * (nonlinear[6] * q + nonlinear[16] * v)
                fast = 2.0 * abs(v) / (abs(v) + 0.5)
                extra += (
                    nonlinear[13] * fast * q + (nonlinear[14] * fast + nonlinear[15] * abs(q)) * v
                )
                for j in range(n):
                    if j != i:
                        other = x[where + j]
                        extra -= nonlinear[12] * other * min(other * other / 0.0025, 4.0)
                force[n + i] = disturbance[i, k] + contraction[i, 1] + extra
            for i in range(n):
                for j in range(n):
                    if i != j:
                        force[n + i] += nonlinear[8] * contraction[j, 1]
                # What a loose cuff doesn't transmit.
                slip[i] = nonlinear[10] * min(
                    max(x[i] - x[where + i], -nonlinear[11]), nonlinear[11]
                )
                force[i] += slip[i]
                force[n + i] += slip[i]
            if s == 0:
                for i in range(n):
                    value = 0.0
                    for j in range(states):
                        value += torque_of[i, j] * x[j]
                    for j in range(2 * n):
                        value += torque_of[i, states + j] * force[j]
                    before[i, k] = value - slip[i]
            for i in range(n):
                force[i] = active[i] - rubs[i] + slip[i]
            for i in range(n):
                value = -slip[i]
                for j in range(states):
                    value += torque_of[i, j] * x[j]
                for j in range(2 * n):
                    value += torque_of[i, states + j] * force[j]
                low[i] += torque_pole * (value - low[i])
                fine[i, k * substeps + s] = low[i]
            oldest = oldest + 1 if oldest + 1 < reflex_steps else 0
            for i in range(states):
                new[i] = 0.0
                for j in range(states):
                    new[i] += A[i, j] * x[j]
                for j in range(2 * n):
                    new[i] += G[i, j] * force[j]
            for i in range(states):
                x[i] = new[i]
    return position, command, before, fine


def simulate_trial(mismatch: Mismatch, joint: int, seed: int) -> Recording:
    """Run the trial that perturbs one joint: half a second at rest before and after it."""
    period = 1.0 / mismatch.rate
    rng = np.random.default_rng([seed, joint])
    settle = round(0.5 * mismatch.rate)
    ticks = round(mismatch.duration * mismatch.rate)
    total = ticks + 2 * settle
    n = mismatch.joints
    perturbation = np.zeros((n, total))
    noise = _perturbation(mismatch, ticks + settle, rng)[settle:]
    size = mismatch.level * PUSH[joint]
    perturbation[joint, settle : settle + ticks] = noise / noise.std() * size
    perturbation[joint, settle + ticks - round(mismatch.pause * mismatch.rate) :] = 0.0

    M, B, K = arm_of(mismatch, joint)
    states, A, G, torque_of = _state_space(mismatch, M, B, K, period / SUBSTEPS)
    disturbance = _disturbance(mismatch, total, rng)
    disturbance += (K @ np.full(n, mismatch.preload))[:, None]
    inertia = np.diag(ROBOT)[:n] * mismatch.robot + np.diag(M)
    lock = min(mismatch.lock, mismatch.rate / 6.0)
    stiff, damped = inertia * lock**2, 2.0 * inertia * lock
    soft = np.array([4.0, 3.0, 1.0])[:n] + 0.5 * np.diag(K)
    gains = np.stack([stiff, damped])
    gains[0, joint] = soft[joint]
    gains[1, joint] = 0.5 * np.sqrt(soft[joint] * inertia[joint])
    gains[1] *= mismatch.rate
    pole = 1.0 - np.exp(-500.0 * period)
    angle_pole = 1.0
    if mismatch.angle_low_pass:
        angle_pole = 1.0 - np.exp(-period / mismatch.angle_low_pass)
    step = period / SUBSTEPS
    torque_pole = 1.0 - np.exp(-step / mismatch.low_pass) if mismatch.low_pass else 1.0
    position, command, before, fine = _run(
        A,
        G,
        torque_of,
        perturbation,
        disturbance,
        gains,
        np.zeros(n),
        pole,
        mismatch.angle_step,
        angle_pole,
        mismatch.friction,
        mismatch.stick,
        mismatch.bristle,
        mismatch.cogging,
        mismatch.reflex,
        max(1, round(mismatch.reflex_delay / step)),
        np.array(
            [
                mismatch.short_range,
                mismatch.cubic * float(K[0, 0]),
                mismatch.waxing * float(K[0, 0]),
                mismatch.relaxing,
                1.0 - np.exp(-step / mismatch.relaxation),
                0.5 * mismatch.one_sided * float(K[0, 0]),
                mismatch.startled * float(K[0, 0]),
                mismatch.rubbing,
                mismatch.reflex_spread,
                mismatch.reflex_length,
                mismatch.cuff if mismatch.loose else 0.0,
                mismatch.loose,
                mismatch.coupled * float(min(K[0, -1], K[-1, 0])),
                mismatch.stiffness_by_speed * float(K[0, 0]),
                mismatch.damping_by_speed * float(B[0, 0]),
                mismatch.damping_by_angle * float(B[0, 0]) / 0.05,
                mismatch.tensed * float(B[0, 0]),
            ]
        ),
        1.0 - np.exp(-step / 0.02),
        step,
        SUBSTEPS,
        round(mismatch.command_delay / step),
        1.0 - np.exp(-step / mismatch.drive_lag) if mismatch.drive_lag else 1.0,
        states,
        mismatch.mean,
        torque_pole,
    )
    torque = _readings(mismatch, before, fine, step)
    torque += mismatch.torque_noise * rng.standard_normal(torque.shape)
    if mismatch.torque_step > 0.0:
        torque = np.round(torque / mismatch.torque_step) * mismatch.torque_step
    stamps = 1_700_000_000_000_000_000 + np.rint(np.arange(total) * (1e9 * period)).astype(np.int64)
    return Recording(
        joint=joint,
        stamps=stamps,
        position=position + POSTURE[:n, None],
        torque=torque,
        perturbation=perturbation,
        command=command,
    )


@lru_cache(maxsize=2)
def _simulated(mismatch: Mismatch, seed: int) -> tuple[Recording, ...]:
    return tuple(simulate_trial(mismatch, joint, seed) for joint in range(mismatch.joints))


def simulate(mismatch: Mismatch, seed: int) -> list[Recording]:
    """Run one trial for each joint, and apply the change of the readings to its arrays.

    Successive mismatches that differ in nothing else share a simulation.
    """
    found = _simulated(mismatch.simulated, seed)
    change = mismatch.readings
    return [one if change is None else change(one) for one in found]


def _perturbation(mismatch: Mismatch, ticks: int, rng: np.random.Generator) -> FloatArray:
    """Return a perturbation of arbitrary size, (ticks,).

    "noise" up to the cut-off; "multisine", which repeats itself every 10 s, with all lines up to
    20 Hz; a number of "sines", from 0.15 Hz up to the cut-off, that never repeat themselves;
    a "chirp" from 0.1 Hz to the cut-off and back every 20 s; a "sweep" from 0.3 Hz to it every
    10 s, or another number of seconds, whose torque grows with the frequency so that the motion is
    steady, as that of position servos; "binary" noise, whose sign is drawn anew every 50 ms;
    "steps" from one of two torques to the other, after which the joint comes to rest; "taps" of
    4 ms in either direction, 0.3 to 0.8 s apart.
    """
    t = np.arange(ticks) / mismatch.rate
    kind, _, number = mismatch.waveform.partition(" ")
    if kind == "noise":
        low_pass = butter(4, mismatch.cutoff, fs=mismatch.rate, output="sos")
        noise: FloatArray = sosfilt(low_pass, rng.standard_normal(ticks))
        return noise
    if kind == "chirp":
        sweep = 0.1 * (mismatch.cutoff / 0.1) ** (0.5 - 0.5 * np.cos(2.0 * np.pi * t / 20.0))
        return np.sin(2.0 * np.pi * np.cumsum(sweep) / mismatch.rate)
    if kind == "sweep":
        every = float(number or 10.0)
        since = t % every
        rate = (mismatch.cutoff - 0.3) / every
        f = 0.3 + rate * since
        return np.asarray((4.0 + f**2) * np.sin(2.0 * np.pi * (0.3 + 0.5 * rate * since) * since))
    if kind == "taps":
        taps = np.cumsum(rng.uniform(0.3, 0.8, round(4.0 * t[-1])))
        near = np.searchsorted(taps, t, side="right") - 1
        since = t - np.append(taps, -1.0)[near]
        return np.asarray(
            rng.choice((-1.0, 1.0), taps.size + 1)[near] * (since < 0.004) * (near >= 0)
        )
    if kind == "binary":
        held = rng.choice((-1.0, 1.0), round(20.0 * t[-1]) + 1)
        return np.asarray(held[(20.0 * t).astype(int)])
    if kind == "steps":
        steps = np.cumsum(rng.uniform(0.4, 1.3, round(3.0 * t[-1])))
        return np.asarray(1.0 - 2.0 * (np.searchsorted(steps, t, side="right") % 2))
    lines = 0.1 * np.arange(1, 201)
    if kind == "sines":
        lines = np.geomspace(0.15, mismatch.cutoff, int(number))
    phases = rng.uniform(0.0, 2.0 * np.pi, lines.size)
    return np.asarray(
        sum(np.cos(2 * np.pi * f * t + p) for f, p in zip(lines, phases, strict=True))
    )


def _readings(mismatch: Mismatch, before: FloatArray, fine: FloatArray, step: float) -> Any:
    """Torque readings (n, ticks) from torques before each update, and filtered ones by step."""
    late = round(mismatch.torque_delay / step)
    places = np.arange(before.shape[1]) * SUBSTEPS
    if mismatch.mean:
        sums = np.cumsum(np.pad(fine, ((0, 0), (1, 0))), axis=1)
        ends = np.clip(places - late, 0, fine.shape[1])
        return (sums[:, ends] - sums[:, np.maximum(ends - SUBSTEPS, 0)]) / SUBSTEPS
    if mismatch.after:
        return fine[:, places].copy()
    if late or mismatch.low_pass:
        return fine[:, np.clip(places - late - (late == 0), 0, fine.shape[1] - 1)].copy()
    return before.copy()


def _disturbance(mismatch: Mismatch, ticks: int, rng: np.random.Generator) -> FloatArray:
    n = mismatch.joints
    total = np.zeros((n, ticks))
    for size, band in (
        (mismatch.voluntary, (0.05, 2.0)),
        (mismatch.tremor, (8.0, 12.0)),
        (mismatch.rhythm, (0.9, 1.1)),
    ):
        if size:
            sos = butter(2, band, btype="band", fs=mismatch.rate, output="sos")
            raw = sosfilt(sos, rng.standard_normal((n, ticks + 20000)), axis=1)[:, 20000:]
            raw = raw / raw.std(axis=1, keepdims=True)
            if mismatch.synchronous:
                raw = np.resize(raw[:, : round(10.0 * mismatch.rate)].T, (ticks, n)).T
            total += size * raw
    if mismatch.twitches:
        begun = rng.random(ticks) < 1.0 / (20.0 * mismatch.rate)
        width = 0.08 * mismatch.rate
        peaks = mismatch.twitches * rng.standard_normal((n, ticks)) * begun
        total += width * np.sqrt(2.0 * np.pi) * gaussian_filter1d(peaks, width)
    return total + mismatch.leaning * np.linspace(-0.5, 0.5, ticks)


def _state_space(
    mismatch: Mismatch, M: FloatArray, B: FloatArray, K: FloatArray, step: float
) -> tuple[int, FloatArray, FloatArray, FloatArray]:
    """Exact discretisation, and the rows that give the transducers' torque from state and force.

    Forces are those on the robot, then those that the arm offers beside M, B and K.
    """
    n = len(M)
    inertia = ROBOT[:n, :n] * mismatch.robot
    viscous = mismatch.viscosity * np.eye(n)
    one, nil = np.eye(n), np.zeros((n, n))
    if mismatch.hand:
        w, rigid = 2.0 * np.pi * mismatch.hand_frequency, (1.0 - mismatch.hand) * M
        damping = 2.0 * mismatch.hand_damping
        stiff, damped = mismatch.hand * w**2 * M, mismatch.hand * damping * w * M
        both = np.linalg.inv(inertia + rigid)
        pulls = [K + stiff, B + damped, -stiff, -damped]
        braked = [K + stiff, B + damped + viscous, -stiff, -damped]
        dynamics = np.block(
            [
                [nil, one, nil, nil],
                [-both @ part for part in braked],
                [nil, nil, nil, one],
                [w**2 * one, damping * w * one, -(w**2) * one, -damping * w * one],
            ]
        )
        forces = np.block([[nil, nil], [both, -both], [nil, nil], [nil, nil]])
        taken = rigid @ both
        of_states = [pull - taken @ part for pull, part in zip(pulls, braked, strict=True)]
        torque_of = np.hstack([*of_states, taken, one - taken])
    elif mismatch.cuff:
        stiff = mismatch.cuff * one
        damped = 0.002 * stiff
        robot, arm = np.linalg.inv(inertia), np.linalg.inv(M)
        dynamics = np.block(
            [
                [nil, one, nil, nil],
                [-robot @ stiff, -robot @ (damped + viscous), robot @ stiff, robot @ damped],
                [nil, nil, nil, one],
                [arm @ stiff, arm @ damped, -arm @ (stiff + K), -arm @ (damped + B)],
            ]
        )
        forces = np.block([[nil, nil], [robot, nil], [nil, nil], [nil, -arm]])
        torque_of = np.hstack([stiff, damped, -stiff, -damped, nil, nil])
    else:
        both = np.linalg.inv(inertia + M)
        dynamics = np.block([[nil, one], [-both @ K, -both @ (B + viscous)]])
        forces = np.block([[nil, nil], [both, -both]])
        torque_of = np.hstack(
            [K - M @ both @ K, B - M @ both @ (B + viscous), M @ both, one - M @ both]
        )
    states = len(dynamics)
    block = np.zeros((states + 2 * n, states + 2 * n))
    block[:states, :states], block[:states, states:] = dynamics, forces
    exact = expm(block * step)
    return (
        states,
        np.ascontiguousarray(exact[:states, :states]),
        np.ascontiguousarray(exact[:states, states:]),
        np.ascontiguousarray(torque_of),
    )


def write_bag(
    path: Path,
    recordings: Sequence[Recording],
    *,
    names: Sequence[str] = NAMES,
    orders: Sequence[Sequence[int]] = ((0, 1), (0, 1), (0, 1)),
    commands: bool = True,
) -> None:
    """Write trials one after the other into a bag, with the `rosbags` library alone.

    Parameters
    ----------
    orders
        Order of the joints in the messages of angles, torques and perturbation.
    """
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    state, array = "sensor_msgs/msg/JointState", "std_msgs/msg/Float64MultiArray"
    State, Header = store.types[state], store.types["std_msgs/msg/Header"]
    Time = store.types["builtin_interfaces/msg/Time"]
    Array, Layout = store.types[array], store.types["std_msgs/msg/MultiArrayLayout"]
    nothing = np.zeros(0)
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        topics = ("joint_states", "torque_sensors", "imbic_controller/perturbation")
        links = [bag.add_connection(f"/{topic}", state, typestore=store) for topic in topics]
        to_drive = bag.add_connection("/effort_controller/commands", array, typestore=store)
        shift = 0
        for recording in recordings:
            streams = (recording.position, recording.torque, recording.perturbation)
            stamps = recording.stamps + shift
            shift = int(stamps[-1] - recording.stamps[0] + 2_000_000_000)
            for k, stamp in enumerate(stamps.tolist()):
                header = Header(Time(stamp // 10**9, stamp % 10**9), "")
                for row, (link, values) in enumerate(zip(links, streams, strict=True)):
                    order = list(orders[row])
                    numbers = np.ascontiguousarray(values[order, k])
                    angle, effort = (numbers, nothing) if row == 0 else (nothing, numbers)
                    named = [names[i] for i in order]
                    message = State(header, named, angle, nothing, effort)
                    bag.write(link, stamp, store.serialize_cdr(message, state))
                if commands and recording.command is not None:
                    data = np.ascontiguousarray(recording.command[:, k])
                    raw = store.serialize_cdr(Array(Layout([], 0), data), array)
                    bag.write(to_drive, stamp, raw)


def changed(**change: Callable[[Any], Any]) -> Callable[[Recording], Recording]:
    """Return a function that changes the named arrays of a recording."""

    def change_all(recording: Recording) -> Recording:
        arrays: dict[str, Any] = {name: f(getattr(recording, name)) for name, f in change.items()}
        return replace(recording, **arrays)

    return change_all
