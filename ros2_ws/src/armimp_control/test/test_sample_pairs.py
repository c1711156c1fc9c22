"""Pairing of readings by stamp: none is taken for another, and none waits for ever."""

from collections.abc import Sequence

from hypothesis import given
from hypothesis import strategies as st

from armimp_control.trial_sequencer import SamplePairs


@given(st.permutations([(what, stamp) for what in "pt" for stamp in range(4)]))
def test_in_any_order_readings_meet_only_those_of_their_stamp_and_the_latest_always_does(
    order: Sequence[tuple[str, int]],
) -> None:
    pairs = SamplePairs()
    met: list[int] = []
    for what, stamp in order:
        other = pairs.other("pt".index(what), stamp, (float(stamp), 0.0))
        if other is not None:
            assert other == (float(stamp), 0.0)
            met.append(stamp)
    assert len(met) == len(set(met))
    assert max(met) == 3


def test_a_reading_whose_partner_was_lost_is_given_up_with_the_next_pair() -> None:
    pairs = SamplePairs()
    assert pairs.other(0, 1, (1.0,)) is None
    assert pairs.other(1, 2, (2.0,)) is None
    assert pairs.other(0, 4, (4.0,)) is None
    assert pairs.other(0, 3, (3.0,)) is None

    assert pairs.other(1, 3, (0.0,)) == (3.0,)

    assert pairs.other(1, 1, (0.0,)) is None
    assert pairs.other(0, 2, (0.0,)) is None
    assert pairs.other(1, 4, (0.0,)) == (4.0,), "it was not older"
