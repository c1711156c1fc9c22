"""Problems as data: each code has a sentence, and a verdict that it concerns."""

import string

from armimp_estimation.problems import (
    SENTENCES,
    Concern,
    Problem,
    ProblemCode,
    Severity,
    spoiled,
)


def test_each_code_has_a_sentence_that_its_values_fill() -> None:
    assert set(SENTENCES) == set(ProblemCode)
    for code, text in SENTENCES.items():
        fields = {name: spec for _, name, spec, _ in string.Formatter().parse(text) if name}
        values = {name: 3 if spec == "d" else 1.5 if spec else "x" for name, spec in fields.items()}
        sentence = Problem(code=code, trial=2, values=values).sentence
        assert sentence.startswith("trial 2: ")
        assert "{" not in sentence
        assert "\n" not in sentence


def test_a_problem_of_the_parameters_leaves_the_impedance_valid() -> None:
    fit = Problem(code=ProblemCode.LACK_OF_FIT, concern=Concern.PARAMETERS, estimator="lpm_full")
    assert spoiled([fit], Concern.PARAMETERS, "lpm_full")
    assert not spoiled([fit], Concern.IMPEDANCE, "lpm_full")
    assert not spoiled([fit], Concern.PARAMETERS, "welch_siso")


def test_a_problem_of_the_impedance_spoils_the_parameters_and_a_note_nothing() -> None:
    stuck = Problem(code=ProblemCode.STUCK)
    note = Problem(code=ProblemCode.DELAY_CORRECTED, severity=Severity.NOTE)
    assert spoiled([stuck], Concern.IMPEDANCE)
    assert spoiled([stuck], Concern.PARAMETERS, "any")
    assert not spoiled([note], Concern.PARAMETERS)
