"""The branch-free elementary functions of the plant, against extended precision of numpy.

That packed values give the bits of single floats, whole experiments show: those of
``test_offline_experiment.py``, side by side and alone.
"""

import numpy as np
import pytest
from numpy.typing import NDArray

from armimp_common.arrays import FloatArray as Array
from armimp_common.compiled import compiled_entry
from armimp_sim.simd import exp_minus, sine_cosine

TURNS = np.linspace(-40.0, 40.0, 20_001)
_EXP_MINUS = compiled_entry(exp_minus)
_SINE_COSINE = compiled_entry(sine_cosine)
QUARTERS = np.arange(-1000, 1001) * (np.pi / 2.0)


def _ulps(computed: Array, exact: NDArray[np.longdouble]) -> Array:
    """Errors in units in the last place of the exact values."""
    unit = np.spacing(np.abs(exact).astype(np.float64))
    return np.asarray(np.abs(computed - exact) / unit, dtype=np.float64)


def _sines_cosines(x: Array) -> tuple[Array, Array]:
    pairs = np.array([_SINE_COSINE(float(value)) for value in x])
    return pairs[:, 0], pairs[:, 1]


def test_exponential_is_accurate_to_an_ulp_and_a_half_and_beyond_its_range_tiny() -> None:
    y = np.concatenate([np.linspace(0.0, 700.0, 20_001), np.geomspace(1e-18, 2.0, 5_001)])
    found = np.array([_EXP_MINUS(float(value)) for value in y])
    assert np.max(_ulps(found, np.exp(-y.astype(np.longdouble)))) < 1.5
    for beyond in (701.0, 1e300, np.inf, np.nan):
        assert _EXP_MINUS(beyond) == _EXP_MINUS(700.0)


def test_sine_and_cosine_over_several_turns_are_accurate_to_two_ulps() -> None:
    exact = TURNS.astype(np.longdouble)
    for found, expected in zip(_sines_cosines(TURNS), (np.sin(exact), np.cos(exact)), strict=True):
        assert np.max(_ulps(found, expected)) < 2.0


@pytest.mark.parametrize("neighbour", [-np.inf, 0.0, np.inf])
def test_beside_multiples_of_a_quarter_turn_the_relative_error_stays_small(
    neighbour: float,
) -> None:
    x: Array = np.asarray(np.nextafter(QUARTERS, neighbour) if neighbour else QUARTERS)
    # Where one of them all but vanishes, only a careful reduction leaves it any digits.
    sine, cosine = _sines_cosines(x)
    assert sine == pytest.approx(np.sin(x), rel=4e-16, abs=0.0)
    assert cosine == pytest.approx(np.cos(x), rel=4e-16, abs=0.0)
