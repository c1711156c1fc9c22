"""Problems by their codes."""

from collections.abc import Iterable

from armimp_estimation.problems import Problem, ProblemCode


def codes(problems: Iterable[Problem]) -> list[ProblemCode]:
    return [one.code for one in problems]


def having(problems: Iterable[Problem], code: ProblemCode) -> list[Problem]:
    return [one for one in problems if one.code is code]
