"""Packed values are those of single floats to the bit; elementary functions are accurate."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from armimp_common.compiled import compiled_entry
from armimp_sim.dynamics import WIDTH, width_for
from armimp_sim.simd import Tag, exp_minus, load, sine_cosine, store, where_less

Array = NDArray[np.float64]
ONE: Tag = (0.0,)
MANY: Tag = (0.0,) * 16
# All kinds of numbers, in no order: signs, zeros, tiny, huge, infinite and none at all.
SPECIAL = (0.0, -0.0, 1.0, -1.0, 5e-324, -1e-308, 1e308, -np.inf, np.inf, np.nan, 0.1, -3.7)


@compiled_entry
def _arithmetic(a: Array, b: Array, factor: float, width: Tag, out: Array) -> None:
    x, y = load(a, 0, width), load(b, 0, width)
    results = (x + y, x - y, x * y, x / y, -x, abs(x), x * factor, factor - y, factor / x, x + 1.0)
    for row in range(len(results)):
        store(out, row * len(width), results[row])


@compiled_entry
def _chosen(a: Array, b: Array, width: Tag, out: Array) -> None:
    x, y = load(a, 0, width), load(b, 0, width)
    store(out, 0, where_less(x, y, x, y))
    store(out, len(width), where_less(x, 0.5, 1.0, y))


def _both_ways(
    operation: Callable[..., None], rows: int, *arrays: Array, constants: tuple[float, ...] = ()
) -> tuple[Array, Array]:
    """Results (rows, 16) of all numbers in one value, and of each number alone."""
    together = np.full((rows, len(MANY)), -1e3)
    operation(*arrays, *constants, MANY, together.reshape(-1))
    alone = np.full((rows, len(MANY)), -2e3)
    for lane in range(len(MANY)):
        one = np.zeros(rows)
        operation(*(array[lane : lane + 1].copy() for array in arrays), *constants, ONE, one)
        alone[:, lane] = one
    return together, alone


def _same_bits(one: Array, other: Array) -> bool:
    """Equal, with the sign of zero; all numbers that are none count as one."""
    a, b = (np.where(np.isnan(values), np.nan, values) for values in (one, other))
    return bool(np.array_equal(a.view(np.int64), b.view(np.int64)))


def _mixed(seed: int) -> tuple[Array, Array]:
    random = np.random.default_rng(seed)
    values = np.concatenate([SPECIAL, random.normal(size=4)])
    return random.permutation(values), random.permutation(values)


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_arithmetic_is_that_of_single_floats_to_the_last_bit(seed: int) -> None:
    a, b = _mixed(seed)
    together, alone = _both_ways(_arithmetic, 10, a, b, constants=(0.3,))
    assert _same_bits(together, alone)
    expected = [a + b, a - b, a * b, a / b, -a, abs(a), a * 0.3, 0.3 - b, 0.3 / a, a + 1.0]
    assert _same_bits(together, np.array(expected))


@pytest.mark.parametrize("seed", range(20))
def test_choice_is_made_lane_by_lane_and_nan_is_never_less(seed: int) -> None:
    a, b = _mixed(seed)
    together, alone = _both_ways(_chosen, 2, a, b)
    assert _same_bits(together, alone)
    assert _same_bits(together, np.array([np.where(a < b, a, b), np.where(a < 0.5, 1.0, b)]))


def test_single_trial_has_a_block_of_its_own_and_several_fill_wide_ones() -> None:
    assert width_for(1) == 1
    assert {width_for(lanes) for lanes in (2, 15, 16, 17, 400)} == {WIDTH}


# --- The branch-free elementary functions, against extended precision of numpy ------------------


TURNS = np.linspace(-40.0, 40.0, 20_001)
QUARTERS = np.arange(-1000, 1001) * (np.pi / 2.0)


def _ulps(computed: Array, exact: NDArray[np.longdouble]) -> Array:
    """Errors in units in the last place of the exact values."""
    unit = np.spacing(np.abs(exact).astype(np.float64))
    return np.asarray(np.abs(computed - exact) / unit, dtype=np.float64)


def _sines_cosines(x: Array) -> tuple[Array, Array]:
    pairs = np.array([sine_cosine(float(value)) for value in x])
    return pairs[:, 0], pairs[:, 1]


@pytest.mark.parametrize(
    "y",
    [np.linspace(0.0, 700.0, 20_001), np.geomspace(1e-18, 700.0, 5_001), np.linspace(0, 2, 5_001)],
    ids=["range", "small", "near_one"],
)
def test_exponential_is_accurate_to_an_ulp_and_a_half(y: Array) -> None:
    found = np.array([exp_minus(float(value)) for value in y])
    assert np.max(_ulps(found, np.exp(-y.astype(np.longdouble)))) < 1.5


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
