"""Picking the messages of one trial after another out of the live streams.

The streams arrive interleaved in any way, each in its own order. The perturbation leads: a trial is
its first ``ticks`` messages from ``start_ns`` on, the sensor samples up to the same stamps, and the
commands of the same ordinal numbers, since every tick has one of each.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from armimp_common.cdr import stamp_of
from armimp_common.contract import (
    COMMANDS,
    DATA_STREAMS,
    JOINT_STATES,
    PERIOD_NS,
    PERTURBATION,
    TORQUE_SENSORS,
)
from armimp_common.trial_status import Phase, TrialStatus

Sink = Callable[[str, bytes, int], None]

_SENSORS = (JOINT_STATES, TORQUE_SENSORS)
_DRIFT = 2e-4
"""By how much the clock of a driver may go wrong relative to the nominal period."""
_OVERDUE_NS = 100_000_000
"""So long after the planned end (ns), whatever is missing is taken for lost."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CollectedTrial:
    """The raw messages of one trial, in order of arrival.

    Attributes
    ----------
    statuses : tuple of TrialStatus
        Those of this trial.
    messages : mapping of str to list of bytes
        By topic of the contract.
    """

    statuses: tuple[TrialStatus, ...]
    messages: Mapping[str, list[bytes]]


class TrialCollector:
    """Collects the messages of the present trial and passes each on as it is accepted.

    Parameters
    ----------
    sink : callable
        Called with topic, message and time (ns) of every accepted message.
    on_complete : callable
        Called with each trial when it is complete, or as complete as it will get.
    """

    def __init__(self, sink: Sink, on_complete: Callable[[CollectedTrial], None]) -> None:
        self._sink = sink
        self._on_complete = on_complete
        self._waiting_statuses: deque[TrialStatus] = deque()
        self._commands: deque[bytes] = deque()
        self._stamps_without_command: deque[int] = deque()
        self._forget()

    @property
    def status(self) -> TrialStatus | None:
        """Last status of the present trial; None between trials."""
        return self._statuses[-1] if self._statuses else None

    @property
    def statuses(self) -> Sequence[TrialStatus]:
        """Statuses of the present trial so far."""
        return self._statuses

    @property
    def messages(self) -> Mapping[str, list[bytes]]:
        """What has been accepted so far in the present trial, by topic."""
        return self._messages

    def _forget(self) -> None:
        self._statuses: list[TrialStatus] = []
        self._messages: dict[str, list[bytes]] = {topic: [] for topic in DATA_STREAMS}
        # Sensor samples ahead of the perturbation, and all messages before the start is known.
        self._ahead: dict[str, deque[tuple[int, bytes]]] = {topic: deque() for topic in _SENSORS}
        self._before_start: list[tuple[str, bytes, int]] = []
        self._start_ns: int | None = None
        self._up_to_ns = -1
        self._latest = dict.fromkeys(DATA_STREAMS, -1)
        self._finished = self._left = False

    def add_status(self, status: TrialStatus) -> None:
        """Take a trial status; those of the next trial wait until the present one is complete."""
        present = self.status
        if present is not None and status.trial != present.trial:
            self._waiting_statuses.append(status)
            return
        if present is None and status.phase not in (Phase.SETTLE, Phase.PERTURB):
            return
        self._statuses.append(status)
        if status.phase is Phase.PERTURB and self._start_ns is None:
            self._begin(status)
        elif status.phase is Phase.ABORTED:
            self.finish()
        elif status.phase in (Phase.REST, Phase.DONE):
            self._left = True
            self._complete_if_all_there()

    def add(self, topic: str, message: bytes) -> None:
        """Take a message of one of the four data streams.

        Raises
        ------
        MalformedMessageError
            If it is too short to have a stamp.
        """
        if topic == COMMANDS:
            if self._stamps_without_command:
                self._accept(COMMANDS, message, self._stamps_without_command.popleft())
            else:
                self._commands.append(message)
            return
        stamp_ns = stamp_of(message)
        if topic == PERTURBATION:
            self._accept(PERTURBATION, message, stamp_ns)
            if self._commands:
                self._accept(COMMANDS, self._commands.popleft(), stamp_ns)
            else:
                self._stamps_without_command.append(stamp_ns)
        else:
            self._accept(topic, message, stamp_ns)

    def finish(self) -> None:
        """Complete the present trial with what there is, if its perturbation has begun."""
        statuses, messages = tuple(self._statuses), self._messages
        begun = self._start_ns is not None
        self._forget()
        if begun:
            self._on_complete(CollectedTrial(statuses=statuses, messages=messages))
        waiting, self._waiting_statuses = self._waiting_statuses, deque()
        for status in waiting:
            self.add_status(status)

    def _begin(self, status: TrialStatus) -> None:
        assert status.start_ns is not None
        self._start_ns = status.start_ns
        self._ticks = status.ticks
        planned = status.ticks * PERIOD_NS
        self._end_ns = status.start_ns + planned + int(planned * _DRIFT) - PERIOD_NS // 2
        earlier, self._before_start = self._before_start, []
        for topic, message, stamp_ns in earlier:
            self._accept(topic, message, stamp_ns)

    def _accept(self, topic: str, message: bytes, stamp_ns: int) -> None:
        start_ns = self._start_ns
        if start_ns is None:
            if self._statuses:
                self._before_start.append((topic, message, stamp_ns))
            return
        if stamp_ns < start_ns:
            return
        self._latest[topic] = stamp_ns
        if topic == PERTURBATION:
            if not self._finished:
                self._lead(message, stamp_ns)
        elif stamp_ns <= self._up_to_ns:
            self._keep(topic, message, stamp_ns)
        elif topic != COMMANDS and not self._finished:
            self._ahead[topic].append((stamp_ns, message))
        if self._finished:
            self._complete_if_all_there()

    def _lead(self, message: bytes, stamp_ns: int) -> None:
        """A perturbation extends the trial up to its stamp."""
        if stamp_ns < self._end_ns:
            self._up_to_ns = max(stamp_ns, self._up_to_ns)
            for topic, waiting in self._ahead.items():
                while waiting and waiting[0][0] <= self._up_to_ns:
                    sensor_stamp, sample = waiting.popleft()
                    self._keep(topic, sample, sensor_stamp)
            self._keep(PERTURBATION, message, stamp_ns)
            self._finished = len(self._messages[PERTURBATION]) == self._ticks
        else:
            self._finished = True

    def _keep(self, topic: str, message: bytes, stamp_ns: int) -> None:
        self._messages[topic].append(message)
        self._sink(topic, message, stamp_ns)

    def _complete_if_all_there(self) -> None:
        if not (self._finished and self._left):
            return
        overdue = self._latest[PERTURBATION] >= self._end_ns + _OVERDUE_NS
        if overdue or all(self._latest[topic] >= self._up_to_ns for topic in DATA_STREAMS):
            self.finish()
