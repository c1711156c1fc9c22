"""The branch-free elementary functions, against extended precision of numpy."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from armimp_sim.simd import exp_minus, sine_cosine

Array = NDArray[np.float64]

TURNS = np.linspace(-40.0, 40.0, 20_001)
QUARTERS = np.arange(-1000, 1001) * (np.pi / 2.0)


def _ulps(computed: Array, exact: NDArray[np.longdouble]) -> Array:
    """Errors in units in the last place of the exact values."""
    unit = np.spacing(np.abs(exact).astype(np.float64))
    return np.asarray(np.abs(computed - exact) / unit, dtype=np.float64)


def _exponentials(y: Array) -> Array:
    return np.array([exp_minus(float(value)) for value in y])


def _sines_cosines(x: Array) -> tuple[Array, Array]:
    pairs = np.array([sine_cosine(float(value)) for value in x])
    return pairs[:, 0], pairs[:, 1]


@pytest.mark.parametrize(
    "y",
    [np.linspace(0.0, 700.0, 20_001), np.geomspace(1e-18, 700.0, 5_001), np.linspace(0, 2, 5_001)],
    ids=["range", "small", "near_one"],
)
def test_exponential_is_accurate_to_an_ulp_and_a_half(y: Array) -> None:
    assert np.max(_ulps(_exponentials(y), np.exp(-y.astype(np.longdouble)))) < 1.5


@pytest.mark.parametrize("y", [700.0, 701.0, 745.2, 1e6, 1e300, np.inf])
def test_exponential_beyond_its_range_stays_a_tiny_positive_number(y: float) -> None:
    assert exp_minus(y) == exp_minus(700.0)
    assert exp_minus(y) == pytest.approx(np.exp(-700.0), rel=1e-14)


def test_sine_and_cosine_over_several_turns_are_accurate_to_two_ulps() -> None:
    sine, cosine = _sines_cosines(TURNS)
    exact = TURNS.astype(np.longdouble)
    assert np.max(_ulps(sine, np.sin(exact))) < 2.0
    assert np.max(_ulps(cosine, np.cos(exact))) < 2.0


@pytest.mark.parametrize("neighbour", [-np.inf, 0.0, np.inf])
def test_beside_multiples_of_a_quarter_turn_the_relative_error_stays_small(
    neighbour: float,
) -> None:
    x: Array = np.asarray(np.nextafter(QUARTERS, neighbour) if neighbour else QUARTERS)
    sine, cosine = _sines_cosines(x)
    # Where one of them all but vanishes, only a careful reduction leaves it any digits.
    assert np.min(np.abs(sine[1::2])) > 0.99
    assert np.max(np.abs(cosine[1::2])) < 1e-12
    assert sine == pytest.approx(np.sin(x), rel=4e-16, abs=0.0)
    assert cosine == pytest.approx(np.cos(x), rel=4e-16, abs=0.0)
