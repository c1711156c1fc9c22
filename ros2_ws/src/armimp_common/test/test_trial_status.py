"""Trial status: what goes onto the wire comes back, and nonsense is refused."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from armimp_common.errors import ConfigurationError, MalformedMessageError
from armimp_common.trial_status import Phase, TrialStatus

STATUS = TrialStatus(
    phase=Phase.PERTURB,
    trial=2,
    trials=3,
    joint=1,
    joint_name="elbow",
    tick=1234,
    start_ns=5_000_000,
    ticks=50_000,
    seed=7,
    valid=True,
)


@st.composite
def statuses(draw: st.DrawFn) -> TrialStatus:
    counts = st.integers(0, 2**62)
    trials = draw(st.integers(1, 100))
    phase = draw(st.sampled_from(Phase))
    start = draw(counts if phase is Phase.PERTURB else st.none() | counts)
    return TrialStatus(
        phase=phase,
        trial=draw(st.integers(1, trials)),
        trials=trials,
        joint=draw(counts),
        joint_name=draw(st.text()),
        tick=draw(counts),
        start_ns=start,
        ticks=draw(counts),
        seed=draw(counts),
        valid=draw(st.booleans()),
        reason=draw(st.text()),
        clipped=draw(counts),
        clipped_intervals=" ".join(draw(st.lists(st.just("3-17") | st.just("0-0"), max_size=100))),
        tare=tuple(draw(st.lists(st.floats(allow_nan=False), max_size=7))),
        tare_error=tuple(draw(st.lists(st.floats(allow_nan=False), max_size=7))),
    )


@given(status=statuses())
def test_any_status_survives_a_round_trip(status: TrialStatus) -> None:
    assert TrialStatus.from_values(status.to_values()) == status


def test_when_a_tare_is_not_numbers_expect_it_refused() -> None:
    with pytest.raises(MalformedMessageError, match=r"tare is not numbers: '0.1 much'"):
        TrialStatus.from_values({**STATUS.to_values(), "tare": "0.1 much"})


def test_joint_counts_from_one_on_the_wire() -> None:
    assert STATUS.joint == 1
    assert STATUS.to_values()["joint"] == "2"


def test_when_keys_are_unknown_expect_them_ignored() -> None:
    assert TrialStatus.from_values({**STATUS.to_values(), "added_later": "x"}) == STATUS


ADDED_LATER = {"clipped", "clipped_intervals", "tare", "tare_error"}


def test_status_of_an_old_bag_that_tells_nothing_of_clipping_and_tare_can_be_read() -> None:
    values = STATUS.to_values()
    old = {key: value for key, value in values.items() if key not in ADDED_LATER}
    assert TrialStatus.from_values(old) == STATUS


@pytest.mark.parametrize("key", [key for key in STATUS.to_values() if key not in ADDED_LATER])
def test_when_a_key_is_missing_expect_malformed_message(key: str) -> None:
    values = STATUS.to_values()
    del values[key]

    with pytest.raises(MalformedMessageError, match=f"{key} is missing"):
        TrialStatus.from_values(values)


@pytest.mark.parametrize(
    ("key", "text"),
    [
        ("phase", "PERTURB"),
        ("phase", ""),
        ("trial", "0"),
        ("trial", "4"),
        ("trial", "two"),
        ("trials", "1.0"),
        ("joint", "0"),
        ("joint", "1_0"),
        ("tick", "-1"),
        ("tick", "٣"),
        ("start_ns", ""),
        ("start_ns", "nan"),
        ("ticks", " 5"),
        ("ticks", "9" * 5000),
        ("seed", "0x10"),
        ("valid", "True"),
        ("clipped", "-1"),
        ("clipped", ""),
        ("clipped_intervals", "3"),
        ("clipped_intervals", "3-4, 5-6"),
        ("clipped_intervals", "3-4  5-6"),
        ("clipped_intervals", "-1-4"),
        ("clipped_intervals", " ".join(["3-4"] * 101)),
    ],
)
def test_when_a_value_is_nonsense_expect_malformed_message(key: str, text: str) -> None:
    with pytest.raises(MalformedMessageError, match=r"^trial status: .*$"):
        TrialStatus.from_values({**STATUS.to_values(), key: text})


@given(
    values=st.dictionaries(
        st.sampled_from(list(STATUS.to_values())),
        st.text() | st.sampled_from(["1", "true", "settle"]),
    )
)
def test_random_values_raise_nothing_but_malformed_message(values: dict[str, str]) -> None:
    try:
        status = TrialStatus.from_values({**STATUS.to_values(), **values})
    except MalformedMessageError:
        return
    assert TrialStatus.from_values(status.to_values()) == status


@pytest.mark.parametrize(
    "change", [{"trial": 0}, {"trial": 4}, {"joint": -1}, {"ticks": -1}, {"start_ns": None}]
)
def test_when_numbers_contradict_expect_configuration_error(change: dict[str, int]) -> None:
    with pytest.raises(ConfigurationError):
        replace(STATUS, **change)  # type: ignore[arg-type]


def test_sentence_tells_trial_joint_and_fault() -> None:
    spoiled = replace(STATUS, phase=Phase.ABORTED, valid=False, reason="no sensor sample")

    assert STATUS.sentence == "trial 2 of 3: perturbing joint 2 (elbow)"
    assert spoiled.sentence == (
        "trial 2 of 3: aborted at joint 2 (elbow); not valid: no sensor sample"
    )
