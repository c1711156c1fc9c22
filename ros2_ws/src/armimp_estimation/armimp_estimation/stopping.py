"""Deciding when a trial has lasted long enough for its standard errors to be below a bound."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from armimp_common.status import NOTICE_TICKS, StoppingDecision
from armimp_estimation.estimators.lpm import FittedColumn

_EVERY = 2.0
"""Time from one decision to the next (s)."""
_GROWTH = 10
"""Decisions on long trials are further apart, by this part of the length so far, as an estimate
from a long record takes long."""


def largest_error(column: FittedColumn) -> tuple[float, str]:
    """Largest relative standard error of a column, and the name of the element, such as ``K21``.

    One standard error over the absolute value of its parameter; infinite for a parameter of 0.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = column.errors / np.abs(column.values)
    relative[np.isnan(relative)] = np.inf
    letter, row = np.unravel_index(int(relative.argmax()), relative.shape)
    return float(relative.max()), f"{'MBK'[letter]}{row + 1}{column.joint + 1}"


@dataclass(frozen=True, kw_only=True)
class PrecisionGoal:
    """When trials may end before their time."""

    bound: float = 0.0
    """Largest relative standard error (one standard error) of M, B and K of the column that the
    trial gives; 0 lets all trials last as long as planned."""
    least: float = 20.0
    """Length that every trial has at least, s."""


class StoppingRule:
    """Decides on one trial at numbers of samples that depend on nothing but the goal.

    Parameters
    ----------
    goal : PrecisionGoal
        With a bound above 0.
    trial : int
        Number of the trial, 1-based.
    planned : int
        Samples that it has at most.
    rate : float
        Samples per second, Hz.
    """

    def __init__(self, goal: PrecisionGoal, *, trial: int, planned: int, rate: float) -> None:
        self._goal = goal
        self._trial = trial
        self._planned = planned
        self._every = round(_EVERY * rate)
        self._announced = False
        self._due: int | None = self._within(max(round(goal.least * rate) - NOTICE_TICKS, 1))

    def decide(
        self, samples: int, column: Callable[[int], FittedColumn | None]
    ) -> StoppingDecision | None:
        """Decide whether the trial has lasted long enough, if it is time.

        Parameters
        ----------
        samples : int
            Samples that are there.
        column : callable
            Gives the column that follows from the first so many samples; None if there is none.

        Returns
        -------
        StoppingDecision or None
            The first one of all announces when the next is made.
        """
        if not self._announced:
            self._announced = True
            return self._decision(0, enough=False)
        if self._due is None or samples < self._due:
            return None
        considered = self._due
        found = column(considered)
        largest, element = (np.nan, "") if found is None else largest_error(found)
        enough = bool(largest < self._goal.bound)
        self._due = None
        if not enough:
            self._due = self._within(considered + max(self._every, considered // _GROWTH))
        return self._decision(considered, enough=enough, largest=largest, element=element)

    def _within(self, samples: int) -> int | None:
        """A number of samples at which it is not too late to end the trial before its time."""
        return samples if samples + NOTICE_TICKS < self._planned else None

    def _decision(
        self, samples: int, *, enough: bool, largest: float = np.nan, element: str = ""
    ) -> StoppingDecision:
        return StoppingDecision(
            trial=self._trial,
            samples=samples,
            enough=enough,
            due=self._due,
            bound=self._goal.bound,
            largest=largest,
            element=element,
        )
