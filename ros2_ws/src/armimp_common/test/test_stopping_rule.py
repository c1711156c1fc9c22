"""Judgements: every one survives its way over the topic, and rubbish is refused."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from armimp_common.diagnostics import Level, judgement_message, values_of
from armimp_common.errors import ConfigurationError, MalformedMessageError
from armimp_common.stopping_rule import JUDGEMENT_NAME, StoppingDecision

GOOD = StoppingDecision(
    trial=2, samples=19_800, enough=False, due=21_800, bound=0.02, largest=0.031, element="K21"
)


@given(
    st.integers(1, 9),
    st.integers(0, 10**7),
    st.booleans(),
    st.one_of(st.none(), st.integers(1, 10**6)),
    st.floats(0.0, 1.0),
    st.floats(0.0),
)
def test_any_judgement_survives_its_way_as_text(
    trial: int, samples: int, enough: bool, later: int | None, bound: float, largest: float
) -> None:
    judgement = StoppingDecision(
        trial=trial,
        samples=samples,
        enough=enough,
        due=None if later is None else samples + later,
        bound=bound,
        largest=largest,
        element="B12",
    )
    assert StoppingDecision.from_values(values_of(judgement_message(judgement))) == judgement


def test_an_error_that_is_not_known_stays_so() -> None:
    unknown = StoppingDecision(trial=1, samples=0, enough=False, due=None, bound=0.02)
    assert math.isnan(StoppingDecision.from_values(unknown.to_values()).largest)


@pytest.mark.parametrize(
    ("key", "text"),
    [
        ("trial", "0"),
        ("trial", "one"),
        ("samples", "-1"),
        ("enough", "yes"),
        ("due", "19800"),
        ("due", "x"),
        ("bound", ""),
        ("largest", "2 %"),
    ],
)
def test_when_a_value_makes_no_sense_expect_malformed_message(key: str, text: str) -> None:
    with pytest.raises(MalformedMessageError, match="judgement: "):
        StoppingDecision.from_values({**GOOD.to_values(), key: text})


@pytest.mark.parametrize("key", list(GOOD.to_values()))
def test_when_a_value_is_missing_expect_its_name(key: str) -> None:
    values = GOOD.to_values()
    del values[key]
    with pytest.raises(MalformedMessageError, match=key):
        StoppingDecision.from_values(values)


def test_when_the_next_one_is_due_before_this_one_expect_error() -> None:
    with pytest.raises(ConfigurationError, match="due at 10 samples"):
        StoppingDecision(trial=1, samples=10, enough=False, due=10, bound=0.02)


def test_message_says_in_words_what_was_found() -> None:
    message = judgement_message(GOOD)
    assert (message.name, message.level) == (JUDGEMENT_NAME, bytes([Level.OK]))
    assert message.message == "trial 2: largest standard error 3.1 % (K21) is not below 2 %"
    first = StoppingDecision(trial=1, samples=0, enough=False, due=5, bound=0.02)
    assert first.sentence == "trial 1: ends once standard errors are below 2 %"
    unknown = StoppingDecision(trial=1, samples=5, enough=False, due=None, bound=0.02)
    assert "standard error not known is not below" in unknown.sentence
