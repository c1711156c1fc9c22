"""The optimal multisine: it tells more of M, B and K at the same limits, which it holds."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from armimp_common.errors import ConfigurationError
from armimp_control import presets
from armimp_control.perturbation import (
    CREST,
    JointPrior,
    PerturbationKind,
    PerturbationParameters,
    crest_factor,
    disturbance,
    perturbation,
)

Array = NDArray[np.float64]
PRIORS = (
    JointPrior(arm=(0.187, 0.9, 12.0), target=(0.2, 2.0, 10.0)),
    JointPrior(arm=(0.06, 0.29, 3.8), target=(0.1, 1.0, 10.0)),
)
ANGLES = (0.044, 0.037)
DURATIONS = [(50_000, 7142), (12_000, 3000), (2000, 1000)]
"""Samples of some trials, and of the period that each gets."""
PERIOD = DURATIONS[0][1]


def _parameters(kind: PerturbationKind, *angles: float) -> PerturbationParameters:
    flat = presets.perturbation(3, 2, kind)
    return flat.model_copy(update={"angle_limit": angles or (0.0,)})


def _signal(parameters: PerturbationParameters, *, joint: int, ticks: int, seed: int = 1) -> Array:
    prior = PRIORS[joint]
    return perturbation(
        parameters, joint=joint, trial=joint + 1, ticks=ticks, seed=seed, prior=prior
    )


def _spectrum(period: Array) -> tuple[Array, Array]:
    """Lines (Hz) and their powers."""
    power = 2.0 * np.abs(np.fft.rfft(period) / period.size) ** 2
    lines = np.flatnonzero(power > 1e-12 * np.max(power))
    return np.asarray(1000.0 * lines / period.size), power[lines]


def _worst_variance(period: Array, prior: JointPrior, cutoff: float = 2.0) -> float:
    """Largest of the variances of M, B and K, relative to the prior, up to a common factor."""
    f, power = _spectrum(period)
    s = 2j * np.pi * f
    slopes = np.array(prior.arm)[:, None] * np.stack([s**2, s, np.ones_like(s)])
    weights = power * np.abs(prior.response(f)) ** 2 / disturbance(f, cutoff)
    information = ((slopes * weights) @ slopes.conj().T).real
    return float(np.max(np.diag(np.linalg.inv(information))))


@pytest.mark.parametrize(("ticks", "period"), DURATIONS)
@pytest.mark.parametrize("joint", [0, 1])
def test_it_tells_more_than_a_flat_multisine_at_the_same_limits(
    joint: int, ticks: int, period: int
) -> None:
    prior, peak = PRIORS[joint], presets.perturbation(3, 2).peak[joint]
    best = _signal(_parameters("optimal", *ANGLES), joint=joint, ticks=ticks)[:period]
    flat = _signal(_parameters("multisine"), joint=joint, ticks=ticks)[:period]
    flat *= min(peak / np.max(np.abs(flat)), ANGLES[joint] / prior.rms_angle(*_spectrum(flat)))
    worst = [_worst_variance(one, prior) for one in (best, flat)]
    assert worst[0] < 0.7 * worst[1]


@pytest.mark.parametrize(("ticks", "period"), DURATIONS)
def test_limits_of_torque_angle_and_crest_factor_are_held(ticks: int, period: int) -> None:
    for seed in range(4):
        for joint in range(2):
            whole = _signal(_parameters("optimal", *ANGLES), joint=joint, ticks=ticks, seed=seed)
            one = whole[:period]
            assert np.array_equal(whole[period:], whole[:-period])
            assert crest_factor(one) < CREST
            torque = np.max(np.abs(one)) / presets.perturbation(3, 2).peak[joint]
            angle = PRIORS[joint].rms_angle(*_spectrum(one)) / ANGLES[joint]
            assert max(torque, angle) == pytest.approx(1.0, abs=1e-9)
            assert min(torque, angle) > 0.75


@pytest.mark.parametrize("kind", ["noise", "multisine"])
def test_other_kinds_are_made_smaller_where_they_move_a_joint_too_far(
    kind: PerturbationKind,
) -> None:
    free = _signal(_parameters(kind), joint=0, ticks=50_000)
    held = _signal(_parameters(kind, 0.02), joint=0, ticks=50_000)
    wide = _signal(_parameters(kind, 0.5), joint=0, ticks=50_000)
    assert np.array_equal(wide, free)
    part = 50_000 if kind == "noise" else PERIOD
    assert PRIORS[0].rms_angle(*_spectrum(held[:part])) == pytest.approx(0.02, rel=1e-6)
    assert np.allclose(held / np.max(held), free / np.max(free))


def test_without_an_expectation_there_is_none() -> None:
    with pytest.raises(ConfigurationError, match="expectation of the arm"):
        perturbation(_parameters("optimal"), joint=0, trial=1, ticks=2000, seed=1)
