"""Problems as data: each code has a sentence, and a verdict that it concerns."""

import string

from armimp_estimation.problems import (
    Concern,
    Problem,
    ProblemCode,
    Severity,
    kinds,
)
from armimp_estimation.verdict import Verdict


def test_each_code_has_one_sentence_that_its_values_fill_and_advice() -> None:
    sentences = [pair for kind in kinds() for pair in kind.sentences.items()]
    assert sorted(code for code, _ in sentences) == sorted(ProblemCode)
    assert all(kind.advice for kind in kinds())
    for code, text in sentences:
        fields = {name: spec for _, name, spec, _ in string.Formatter().parse(text) if name}
        values = {name: 3 if spec == "d" else 1.5 if spec else "x" for name, spec in fields.items()}
        sentence = Problem(code=code, trial=2, values=values).sentence
        assert sentence.startswith("trial 2: ")
        assert "{" not in sentence
        assert "\n" not in sentence


def test_a_problem_of_the_parameters_leaves_the_impedance_valid() -> None:
    fit = Problem(code=ProblemCode.LACK_OF_FIT, concern=Concern.PARAMETERS, estimator="lpm_full")
    assert Verdict.of([fit], "lpm_full") == Verdict(impedance=True, parameters=False)
    assert Verdict.of([fit], "welch_siso") == Verdict(impedance=True, parameters=True)


def test_a_problem_of_the_impedance_spoils_the_parameters_and_a_note_nothing() -> None:
    stuck = Problem(code=ProblemCode.STUCK)
    note = Problem(code=ProblemCode.DELAY_CORRECTED, severity=Severity.NOTE)
    assert Verdict.of([stuck], "any") == Verdict(impedance=False, parameters=False)
    assert Verdict.of([note], "any") == Verdict(impedance=True, parameters=True)


def test_without_an_estimator_nothing_can_be_trusted() -> None:
    assert Verdict.of([]) == Verdict(impedance=False, parameters=False)
