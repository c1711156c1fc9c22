"""How long a run takes before, in and after its trials, on the clock on the wall."""

from __future__ import annotations

import math
import time

from armimp_common.processes import age
from armimp_common.trial_status import Phase
from armimp_estimation.results import WallSummary


class Stopwatch:
    """Started with the process, however late it is made.

    The trials last from the first sample of the first one to the last sample of the last one that
    is perturbed. What is before are imports and the bringing up of the graph, what is after the
    estimates and everything that is written.
    """

    def __init__(self) -> None:
        self._began = time.monotonic() - age()
        self._first = self._last = math.nan
        self._perturbing = False

    def note(self, phase: Phase) -> None:
        """Take note that a phase of a trial begins."""
        now = time.monotonic()
        if phase is Phase.PERTURB:
            if math.isnan(self._first):
                self._first = now
            self._perturbing = True
        elif self._perturbing:
            self._last, self._perturbing = now, False

    def stop(self) -> WallSummary:
        """Wall times until now; NaN without any sample."""
        return WallSummary(
            before=self._first - self._began,
            trials=self._last - self._first,
            after=time.monotonic() - self._last,
        )
