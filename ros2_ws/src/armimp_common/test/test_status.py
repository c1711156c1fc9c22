"""Statuses: what goes onto the wire comes back, and nonsense is refused."""

from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from hypothesis import given
from hypothesis import strategies as st

from armimp_common import status as statuses
from armimp_common.errors import MalformedMessageError
from armimp_common.status import Cause, Phase, StoppingDecision, TimingFigures, TrialStatus
from support.streams import changed, trial_status

STATUS = trial_status(
    trial=2, trials=3, joint=1, joint_name="elbow", tick=1234, start_ns=5_000_000, ticks=50_000
)
DECISION = StoppingDecision(
    trial=2, samples=19_800, enough=False, due=21_800, bound=0.02, largest=0.031, element="K21"
)
TIMING = TimingFigures(ticks=1000, late=10, missed=10, period_p50=1e-3, latency_p99=1e-3)
RECORDS: tuple[Any, ...] = (STATUS, DECISION, TIMING)
counts = st.integers(0, 2**62)
tares = st.lists(st.floats(allow_nan=False), max_size=7).map(tuple)


@st.composite
def trial_statuses(draw: st.DrawFn) -> TrialStatus:
    trials = draw(st.integers(1, 100))
    phase = draw(st.sampled_from(Phase))
    return TrialStatus(
        phase=phase,
        trial=draw(st.integers(1, trials)),
        trials=trials,
        joint=draw(counts),
        joint_name=draw(st.text()),
        tick=draw(counts),
        start_ns=draw(counts if phase is Phase.PERTURB else st.none() | counts),
        ticks=draw(counts),
        seed=draw(counts),
        valid=draw(st.booleans()),
        cause=draw(st.sampled_from(Cause)),
        reason=draw(st.text()),
        lost=draw(counts),
        clipped=draw(counts),
        clipped_intervals=" ".join(draw(st.lists(st.just("3-17") | st.just("0-0"), max_size=100))),
        tare=draw(tares),
        tare_error=draw(tares),
    )


@given(record=trial_statuses())
def test_any_status_survives_its_way_through_a_message(record: TrialStatus) -> None:
    assert TrialStatus.from_values({**record.to_values(), "added_later": "x"}) == record


@pytest.mark.parametrize("record", RECORDS)
def test_a_message_has_the_record_in_words_and_as_values(record: Any) -> None:
    message = statuses.status_message(record)
    assert message.name == record.STATUS_NAME
    assert message.message == record.sentence
    assert repr(type(record).from_values(statuses.values_of(message))) == repr(record)


@pytest.mark.parametrize(
    ("phase", "valid", "level"),
    [
        (Phase.SETTLE, True, DiagnosticStatus.OK),
        (Phase.SETTLE, False, DiagnosticStatus.WARN),
        (Phase.ABORTED, False, DiagnosticStatus.ERROR),
    ],
)
def test_the_level_of_a_trial_tells_whether_it_is_valid(
    phase: Phase, valid: bool, level: bytes
) -> None:
    assert statuses.status_message(changed(STATUS, phase=phase, valid=valid)).level == level


@pytest.mark.parametrize(
    ("record", "key"), [(record, key) for record in RECORDS for key in record.to_values()]
)
def test_when_a_value_is_missing_expect_it_named_unless_it_has_a_default(
    record: Any, key: str
) -> None:
    values = {name: value for name, value in record.to_values().items() if name != key}
    if not type(record).model_fields[key].is_required():
        type(record).from_values(values)
        return
    with pytest.raises(MalformedMessageError, match=f"{key} is missing"):
        type(record).from_values(values)


@pytest.mark.parametrize(
    ("record", "key", "text"),
    [
        *((STATUS, "phase", text) for text in ("PERTURB", "")),
        *((STATUS, "trial", text) for text in ("0", "4", "two")),
        *((STATUS, "joint", text) for text in ("0", "first", "9" * 5000)),
        (STATUS, "tick", "-1"),
        *((STATUS, "start_ns", text) for text in ("", "nan")),
        *((STATUS, "ticks", text) for text in ("9" * 5000, "1.5")),
        *((STATUS, "valid", text) for text in ("perhaps", "")),
        *((STATUS, "cause", text) for text in ("elsewhere",)),
        *((STATUS, "clipped", text) for text in ("-1", "")),
        *((STATUS, "clipped_intervals", text) for text in ("3", "3-4, 5-6", "3-4  5-6", "-1-4")),
        (STATUS, "clipped_intervals", " ".join(["3-4"] * 101)),
        (STATUS, "tare", "0.1 much"),
        *((DECISION, "due", text) for text in ("19800", "x")),
        *((DECISION, "largest", text) for text in ("2 %", "")),
        *((TIMING, "late", text) for text in ("many", "-1", "1001")),
        (TIMING, "period_max", "long"),
    ],
)
def test_when_a_value_is_nonsense_expect_malformed_message(
    record: Any, key: str, text: str
) -> None:
    what = record.STATUS_NAME.partition(": ")[2]
    with pytest.raises(MalformedMessageError, match=rf"^{what}: .*{key.split('_', 1)[0]}"):
        type(record).from_values({**record.to_values(), key: text})
