"""Advice for problems by their codes, and how numbers and their origins are written."""

import json

import pytest

from armimp_estimation.problems import ProblemCode
from armimp_estimation.report.advice import ADVICE, advise
from armimp_estimation.report.formats import difference, number, percent, uncertain
from armimp_estimation.report.settings import ASSUMPTION, CHOSEN, assumptions_content, origin
from support.results import METADATA

CONFIG = json.loads(METADATA["config"])


def test_each_code_has_advice_of_one_kind() -> None:
    kinds = [code for advice in ADVICE for code in advice.codes]
    assert sorted(kinds) == sorted(ProblemCode)
    assert all(advice.text for advice in ADVICE)


def test_problems_of_one_kind_come_together_in_their_order() -> None:
    found = advise(
        [
            (ProblemCode.NODE_FAILED, "node a died"),
            (ProblemCode.INTERRUPTED, "interrupted by the user"),
            (ProblemCode.NODE_FAILED, "node b died"),
        ]
    )
    assert [(advice.title, sentences) for advice, sentences in found] == [
        ("A node failed", ["node a died", "node b died"]),
        ("The run was stopped", ["interrupted by the user"]),
    ]


def test_parameters_say_where_they_come_from() -> None:
    assert origin(CONFIG, "arm_sim", "arm.inertia") == "paper, Table I"
    assert origin(CONFIG, "arm_sim", "friction.coulomb") == ASSUMPTION
    assert origin(CONFIG, "arm_sim", "robot.masses") == ASSUMPTION
    assert origin(CONFIG, "imbic_controller", "target.damping") == ASSUMPTION
    assert origin(CONFIG, "imbic_controller", "law.gamma") == CHOSEN
    assert origin(CONFIG, "arm_sim", "joints") == ""


@pytest.mark.parametrize(("joints", "title"), [(3, "Third joint"), (5, "Arm")])
def test_of_more_than_two_joints_the_paper_says_nothing(joints: int, title: str) -> None:
    config = {"experiment": {"joints": joints}, "arm_sim": {}}
    assert ASSUMPTION in origin(config, "arm_sim", "arm.inertia")
    content = assumptions_content(config)
    assert content is not None
    assert content["assumptions"][0][0] == title


@pytest.mark.parametrize("config", [{}, {"experiment": "text"}, {"experiment": None}, {"a": [1]}])
def test_a_configuration_of_another_kind_is_taken_without_assumptions(
    config: dict[str, object],
) -> None:
    assert assumptions_content(config) is None
    assert origin(config, "arm_sim", "unheard_of") == ""


def test_an_error_gets_two_digits_and_the_estimate_as_many_decimals() -> None:
    assert uncertain(0.184406, 0.00069951) == "0.18441 ± 0.00070"
    assert uncertain(-7.98196, 0.24772) == "−7.98 ± 0.25"
    assert uncertain(1234.5, 35.8) == "1234 ± 36"
    assert uncertain(2.0, float("nan")) == "2 ± –"
    assert uncertain(float("nan"), 0.0) == "– ± –"


def test_what_is_not_a_number_is_a_dash() -> None:
    assert number(float("inf")) == percent(float("nan")) == difference(1.0, 0.0) == "–"
    assert difference(1.1, 1.0) == "+10.00\N{NARROW NO-BREAK SPACE}%"
    assert number(62.708, ".1f", "°") == "62.7°"
