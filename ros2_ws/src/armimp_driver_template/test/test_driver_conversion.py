"""Counts into radians and newton metres."""

import math

from armimp_driver_template.conversion import Encoders, Transducers

COUNT = 2.0 * math.pi / 51200


def test_angles_go_on_where_counters_wrap() -> None:
    encoders = Encoders(COUNT, [60000])
    raw = [65530, 65535, 3, 65534, 65000]
    counts = [5530, 5535, 5539, 5534, 5000]
    assert [encoders.angles([value]) for value in raw] == [(count * COUNT,) for count in counts]


def test_first_angles_lie_within_half_the_range_of_zero() -> None:
    assert Encoders(COUNT, [60000, 100]).angles([3000, 65500]) == (8536 * COUNT, -136 * COUNT)


def test_an_encoder_that_counts_backwards_has_a_negative_resolution() -> None:
    encoders = Encoders(-COUNT, [0])
    assert encoders.angles([10]) == (-10 * COUNT,)


def test_torques_lack_the_reading_without_load() -> None:
    assert Transducers(0.02, [1250, -400]).torques([1251, -410]) == (0.02, -0.2)
