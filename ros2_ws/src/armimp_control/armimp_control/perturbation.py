"""The torque τ_Δ, known exactly, that serves as the instrument of every estimate."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from armimp_common.arrays import ComplexArray, FloatArray
from armimp_common.compiled import compiled_entry
from armimp_common.schema import NonNegativeVector, PositiveVector, Schema
from armimp_common.topics import RATE

_STREAM = 1  # keeps these random streams apart from those of the voluntary torque
_LINES = 7  # likewise for the lines of a multisine, which all trials have in common

_ORDER = 8  # of the low-pass of the noise

PerturbationKind: TypeAlias = Literal["noise", "multisine", "optimal"]

CREST_OF_NOISE = 3.65
"""Crest factor of the noise: mean over trials of 50 s, which have 3.2 to 4.3."""
_FEWEST_PERIODS = 4  # of a multisine in a trial
_SHORTEST_PERIOD = 1.0  # s, of a multisine
_GROUP = 4  # neighbouring odd harmonics, one of which is left out
_GRID = 16  # points, per period of the highest line, at which the crest factor is lowered
_ROUNDS = 600  # of clipping, for each draw of phases
_CLIP = 0.9  # level of clipping, relative to the peak
_DRAWS = 4  # of phases, at most
CREST = 1.8
"""Crest factor above which phases are drawn again."""
_EXPECTED_CREST = 1.7  # of an optimal multisine, to get its rms from its peak
_SPREADS = (0.2, 0.3, 0.45, 0.7)
"""Shares of the power, tried in turn, that are spread evenly over all lines despite the prior.

They reveal arms that M, B and K do not describe.
"""

_STEPS = 500  # of the algorithm for optimal powers
_EVERYWHERE = 2e-3
"""Floor of the density of the disturbance, relative to the lowest frequencies; an assumption."""


@dataclass(frozen=True, kw_only=True)
class JointPrior:
    """Expected M, B and K of the arm and of the target impedance at a perturbed joint, SI units."""

    arm: tuple[float, float, float]
    """Diagonal elements of the arm's M, B and K."""
    target: tuple[float, float, float]
    """Those of the target impedance, with which the robot yields."""

    def response(self, f: FloatArray) -> ComplexArray:
        """Return the response of the angle to the perturbation at frequencies (Hz), rad/(N·m)."""
        M, B, K = np.add(self.arm, self.target)
        s = 2j * np.pi * f
        return np.asarray(1.0 / ((M * s + B) * s + K))

    def rms_angle(self, f: FloatArray, power: FloatArray) -> float:
        """Return the rms angle (rad) that torques of this power (N·m)² at the frequencies cause."""
        return float(np.sqrt(np.sum(power * np.abs(self.response(f)) ** 2)))


class PerturbationParameters(Schema):
    """The perturbation τ_Δ: noise through a low-pass, or a multisine, flat or optimal."""

    kind: PerturbationKind = "noise"
    """Kind of the perturbation: noise, uniform, through a Butterworth low-pass; or multisine, odd
    harmonics with random phases and a low crest factor, of equal amplitudes up to the cut-off
    frequency; or optimal, a multisine with the amplitudes that are most informative about M, B and
    K of the expected arm."""
    peak: PositiveVector
    """Largest perturbation torque of each joint while it is perturbed (N·m); a multisine has the
    rms of noise with this peak, and about half the peak; an optimal one has this peak if the angle
    allows it."""
    angle_limit: NonNegativeVector = (0.0,)
    """Largest rms angle by which the perturbation may move each joint, as predicted from the
    expected arm (rad); a larger perturbation is scaled down; one value for all joints or one for
    each; 0: no limit or, for optimal, the angle of a multisine with this peak."""
    disturbance_cutoff: float = Field(default=2.0, gt=0.0, le=0.5 * RATE)
    """Frequency up to which a person is expected to move voluntarily (Hz); an optimal perturbation
    stays above it as far as that pays."""
    cutoff: float = Field(default=15.0, gt=0.0, lt=0.5 * RATE)
    """Cut-off frequency of the perturbation (Hz)."""
    period: float = Field(default=8.192, ge=_SHORTEST_PERIOD, le=100.0)
    """Longest period of the multisine (s); it is made shorter until a whole number of them, four or
    more, fills the trial."""


def perturbation(
    parameters: PerturbationParameters,
    *,
    joint: int,
    trial: int,
    ticks: int,
    seed: int,
    prior: JointPrior,
) -> FloatArray:
    """Return the signal τ_Δ of one trial; the same for the same arguments.

    A multisine repeats for as long as the trial lasts, and begins where it is nearest to zero.

    Parameters
    ----------
    parameters : PerturbationParameters
    joint : perturbed joint, 0-based; chooses the peak
    trial : trial number, chooses an independent random stream
    ticks : number of samples
    seed : of the experiment, not negative
    prior : what is expected of the joint; for optimal multisines and limits of the angle

    Returns
    -------
    (ticks,) NDArray
        N·m. The largest absolute value of noise is the peak, unless the angle limit reduces it.
    """
    peak = parameters.peak[joint]
    limits = parameters.angle_limit
    limit = limits[joint if len(limits) > 1 else 0]
    random = np.random.default_rng(np.random.SeedSequence([seed, _STREAM, trial]))
    if parameters.kind == "noise":
        white = random.uniform(-1.0, 1.0, ticks)
        coloured = filtered(butterworth(parameters.cutoff, RATE), white)
        # In this order, the largest value is the peak exactly.
        signal = coloured / np.max(np.abs(coloured)) * peak
    else:
        lines, period = multisine_lines(parameters, ticks=ticks, seed=seed)
        f = np.asarray(lines * (RATE / period), dtype=np.float64)
        power = np.full(lines.size, (peak / CREST_OF_NOISE) ** 2 / lines.size)
        if parameters.kind == "multisine":
            signal = multisine(lines, power, period, random)
        else:
            limit = limit or prior.rms_angle(f, power)
            torque, cutoff = peak / _EXPECTED_CREST, parameters.disturbance_cutoff
            # A few lines beat with each other: if the crest factor is high, more need power.
            for spread in _SPREADS:
                power = optimal_power(
                    f, prior, torque=torque, angle=limit, cutoff=cutoff, spread=spread
                )
                signal = multisine(lines, power, period, random)
                if crest_factor(signal) < CREST:
                    break
            signal *= peak / np.max(np.abs(signal))
    if limit:
        f = np.asarray(np.fft.rfftfreq(signal.size, 1.0 / RATE), dtype=np.float64)
        power = 2.0 * np.abs(np.fft.rfft(signal) / signal.size) ** 2
        signal *= min(1.0, limit / prior.rms_angle(f, power))
    repeated: FloatArray = np.resize(signal, ticks)
    return repeated


def disturbance(f: FloatArray, cutoff: float) -> FloatArray:
    """Return the relative spectral density of the disturbance: second-order low-pass noise.

    Owing to tremor, sensors and the friction of a robot, it does not fall below a constant.
    """
    return np.asarray(1.0 / (1.0 + (f / cutoff) ** 4) + _EVERYWHERE)


def optimal_power(
    f: FloatArray, prior: JointPrior, *, torque: float, angle: float, cutoff: float, spread: float
) -> FloatArray:
    """Return the powers of the lines for which the worst relative error of M, B and K is least.

    While joint k is perturbed and the others are locked, its angle answers the perturbation by
    ``R = 1/(Z_rd + Z_kk)``, with the target impedance and that of the arm. With lines of power p_l
    (N·m)² and a disturbance of spectral density S, one second of data has the Fisher information

        F = Σ_l 2 p_l |R_l|²/S_l Re(conj(φ_l) φ_lᵀ) ,    φ = (s², s, 1)

    about M, B and K of any row of column k. The powers are those for which the largest of the
    relative standard errors ``sqrt((F⁻¹)_aa)/x_a`` is least, with the prior arm for x, under limits
    of the rms torque, ``Σ p_l ≤ T²``, and of the rms angle, ``Σ p_l |R_l|² ≤ A²``. The problem is
    convex. The weight of each parameter and of each limit grows while it is the worst, and the
    powers follow by the multiplicative algorithm for A-optimal designs, ``p_l ← p_l
    sqrt(g_l/c_l)``, with the sensitivity g of the weighted sum of variances and the cost c of the
    weighted limits (Silvey, Titterington & Torsney, Commun. Statist. Theory Methods A7, 1978;
    Pintelon & Schoukens, *System Identification: A Frequency Domain Approach*, 2nd ed., section
    5.4).

    Parameters
    ----------
    f : (n,) lines, Hz
    prior : JointPrior
    torque, angle : largest rms of the perturbation and of the motion, N·m and rad
    cutoff : of the disturbance, Hz
    spread : share of the power, as the limits count it, that is spread evenly over all lines

    Returns
    -------
    (n,) NDArray
        (N·m)²; one of the limits is reached.
    """
    s = 2j * np.pi * f
    # Derivatives of Z by ln M, ln B and ln K, and the information per unit of power of each line.
    slopes = np.array(prior.arm)[:, None] * np.stack([s**2, s, np.ones_like(s)])
    told = np.abs(prior.response(f)) ** 2 / disturbance(f, cutoff)
    limits = np.stack([np.ones(f.size) / torque**2, np.abs(prior.response(f)) ** 2 / angle**2])
    of_limits, of_errors = np.full(2, 0.5), np.full(3, 1.0 / 3.0)
    free = np.full(f.size, 1.0 / f.size)
    for _ in range(_STEPS):
        cost = of_limits @ limits
        free *= (1.0 - spread) / (cost @ free)
        power = free + spread / np.sum(cost)
        covariance = np.linalg.inv(((slopes * (told * power)) @ slopes.conj().T).real)
        of_errors = of_errors * np.diag(covariance)
        of_errors /= np.sum(of_errors)
        used = limits @ power
        of_limits = of_limits * np.sqrt(used)
        of_limits /= np.sum(of_limits)
        change = covariance @ (of_errors[:, None] * covariance)
        sensitivity = told * np.sum((slopes.conj() * (change @ slopes)).real, axis=0)
        free *= np.sqrt(sensitivity / cost)
    return np.asarray(power / np.max(limits @ power))


def multisine_lines(
    parameters: PerturbationParameters, *, ticks: int, seed: int
) -> tuple[NDArray[np.intp], int]:
    """Return the odd harmonics of a multisine without one of each four neighbours; its period.

    Those left out are drawn at random, the same in all trials of an experiment. Even distortion
    then shows at even harmonics, odd distortion at those left out (Pintelon & Schoukens, *System
    Identification: A Frequency Domain Approach*, 2nd ed., ch. 4).

    Parameters
    ----------
    parameters : PerturbationParameters
    ticks : number of samples of the trial
    seed : of the experiment, not negative

    Returns
    -------
    lines : (n_lines,) NDArray
    period : int
        Samples.
    """
    periods = max(math.ceil(ticks / (parameters.period * RATE)), _FEWEST_PERIODS)
    period = max(ticks // periods, round(_SHORTEST_PERIOD * RATE))
    count = max(int((parameters.cutoff * period / RATE + 1.0) / 2.0), 1)
    lines = 2 * np.arange(count) + 1
    choice = np.random.default_rng(np.random.SeedSequence([seed, _LINES]))
    groups = count // _GROUP
    left_out = _GROUP * np.arange(groups) + choice.integers(_GROUP, size=groups)
    # The lowest line, most informative about the stiffness, stays.
    return np.delete(lines, left_out[left_out > 0]), period


def multisine(
    lines: NDArray[np.intp], power: FloatArray, period: int, random: np.random.Generator
) -> FloatArray:
    """Return one period of a multisine with a low crest factor.

    From random phases on, the signal is clipped and its amplitudes are restored, in turn (van der
    Ouderaa, Schoukens & Renneboog, IEEE Trans. Instrum. Meas. 37(1), 1988). This leads to a crest
    factor of 1.5 to 1.8; if it is larger, up to three further draws of phases are tried.

    Parameters
    ----------
    lines : (n_lines,) harmonics
    power : (n_lines,) power of each, (N·m)²
    period : samples
    random : draws the phases

    Returns
    -------
    (period,) NDArray
        N·m. Begins where it is nearest to zero.
    """
    amplitudes = np.sqrt(2.0 * power)
    grid = _GRID * int(lines[-1] + 1)
    best, least = np.zeros(0, dtype=np.complex128), np.inf
    for _ in range(_DRAWS):
        values = np.exp(2j * np.pi * random.uniform(size=lines.size))
        spectrum = np.zeros(grid // 2 + 1, dtype=np.complex128)
        for _ in range(_ROUNDS):
            spectrum[lines] = amplitudes * values
            signal = np.fft.irfft(spectrum, grid)
            level = _CLIP * np.max(np.abs(signal))
            clipped = np.fft.rfft(np.clip(signal, -level, level))[lines]
            values = clipped / np.abs(clipped)
        spectrum[lines] = amplitudes * values
        signal = np.fft.irfft(spectrum, grid)
        crest = crest_factor(signal)
        if crest < least:
            best, least = values, crest
        if crest < CREST:
            break
    spectrum = np.zeros(period // 2 + 1, dtype=np.complex128)
    spectrum[lines] = 0.5 * period * amplitudes * best
    signal = np.fft.irfft(spectrum, period)
    begun: FloatArray = np.roll(signal, -int(np.argmin(np.abs(signal))))
    return begun


def crest_factor(signal: FloatArray) -> float:
    """Return the largest absolute value over the rms."""
    return float(np.max(np.abs(signal)) / np.sqrt(np.mean(signal**2)))


def butterworth(cutoff: float, rate: float) -> FloatArray:
    """Return what ``scipy.signal.butter(8, cutoff, fs=rate, output="sos")`` gives, to the bit.

    Importing `scipy.signal` takes longer than everything else that a run imports, and this filter
    is all that the graph needs of it.

    Parameters
    ----------
    cutoff : where half the power passes, below half the rate, Hz
    rate : of the samples, Hz

    Returns
    -------
    (4, 6) NDArray
        b0, b1, b2, 1, a1, a2 of each section; the poles nearest to the unit circle come last.
    """
    twice = 4.0  # twice the rate, in units in which the bilinear transform has a rate of 2
    warped = float(twice * np.tan(np.pi * (cutoff / (rate / 2.0)) / 2.0))
    places = np.arange(1 - _ORDER, _ORDER, 2, dtype=np.float64)
    analogue = warped * -np.exp(1j * np.pi * places / (2 * _ORDER))
    poles = (twice + analogue) / (twice - analogue)
    upper = sorted(poles[: _ORDER // 2], key=abs)
    sections = np.zeros((_ORDER // 2, 6))
    sections[:, :3] = 1.0, 2.0, 1.0
    sections[:, 3:] = [np.real(np.poly((pole, pole.conjugate()))) for pole in upper]
    sections[0, :3] *= warped**_ORDER * np.real(1.0 / np.prod(twice - analogue))
    return sections


@compiled_entry
def filtered(sections: FloatArray, signal: FloatArray) -> FloatArray:
    """Filter a signal from rest, like ``scipy.signal.sosfilt``.

    Parameters
    ----------
    sections : (n_sections, 6) NDArray
        See `butterworth`.
    signal : (n_samples,) NDArray

    Returns
    -------
    (n_samples,) NDArray
    """
    state = np.zeros((sections.shape[0], 2))
    out = np.empty_like(signal)
    for n in range(signal.size):
        value = signal[n]
        for s in range(sections.shape[0]):
            entered = value
            value = sections[s, 0] * entered + state[s, 0]
            state[s, 0] = sections[s, 1] * entered - sections[s, 4] * value + state[s, 1]
            state[s, 1] = sections[s, 2] * entered - sections[s, 5] * value
        out[n] = value
    return out
