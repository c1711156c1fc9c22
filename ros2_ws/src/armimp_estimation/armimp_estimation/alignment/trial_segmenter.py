"""Picking the messages of one trial after another out of the live streams.

Streams and statuses arrive interleaved in any way, each in its own order. The perturbation leads:
a trial is its first ``ticks`` messages from ``start_ns`` on, the sensor samples up to the same
stamps, and the commands of the same ordinal numbers, since every tick has one of each.
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from armimp_common.cdr import stamp_of
from armimp_common.errors import MalformedMessageError
from armimp_common.status import Phase, TrialStatus
from armimp_common.topics import (
    COMMANDS,
    DATA_STREAMS,
    JOINT_STATES,
    PERIOD_NS,
    PERTURBATION,
    TORQUE_SENSORS,
)
from armimp_estimation.alignment.sample_batch import ORDER, SampleBatch, block_of

Sink = Callable[[str, bytes, int], None]
BlockSink = Callable[[SampleBatch], None]
Refuse = Callable[[str, MalformedMessageError], None]

_FOLLOWERS = (JOINT_STATES, TORQUE_SENSORS, COMMANDS)
_KEPT_EARLY = 30_000
"""Messages of each stream that may be ahead of a status, or of the other streams."""
_DRIFT = 2e-4
"""By how much the clock of a driver may go wrong relative to the nominal period."""
_ASTRAY_NS = 1_000_000_000
"""A stamp so far (ns) ahead of the next one of its stream is wrong: nothing waits for its time."""
_OVERDUE_NS = 2_000_000_000
"""So long after the planned end (ns), whatever is missing is lost: queues hold no more."""


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


class TrialSegmenter:
    """Collects the messages of the present trial and passes each on as it is accepted.

    Parameters
    ----------
    sink : callable
        Called with topic, message and time (ns) of every accepted message.
    on_complete : callable
        Called with each trial when it is complete, or as complete as it will get.
    on_begin : callable
        Called with the first status of each trial.
    block_sink : callable, optional
        Called instead of `sink` with ticks that were accepted together.
    """

    def __init__(
        self,
        sink: Sink,
        on_complete: Callable[[CollectedTrial], None],
        on_begin: Callable[[TrialStatus], None] = lambda _: None,
        block_sink: BlockSink | None = None,
    ) -> None:
        self._sink = sink
        self._block_sink = block_sink
        self._on_complete = on_complete
        self._on_begin = on_begin
        self._waiting_statuses: deque[TrialStatus] = deque()
        self._commands: deque[bytes] = deque()
        self._stamps_without_command: deque[int] = deque()
        self._led_ns = -1
        self._odd_ns: int | None = None
        self._early = _nothing_early()
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
        if present is None:
            if status.phase not in (Phase.SETTLE, Phase.PERTURB):
                return
            self._on_begin(status)
        self._statuses.append(status)
        if status.phase is Phase.PERTURB and self._start_ns is None:
            self._begin(status)
        elif self._start_ns is not None and status.ticks < self._ticks:
            self._shorten(status.ticks)
        if status.phase is Phase.ABORTED:
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
            for answered_ns in self._answered(stamp_ns):
                if self._commands:
                    self._accept(COMMANDS, self._commands.popleft(), answered_ns)
                else:
                    self._stamps_without_command.append(answered_ns)
        else:
            self._accept(topic, message, stamp_ns)

    def _answered(self, stamp_ns: int) -> tuple[int, ...]:
        """Stamps (ns) of perturbations with which commands go, now that this one has come.

        No command goes with one that is no newer than those before, as of somebody else, unless
        the next one follows it: then time has begun anew.
        """
        odd_ns, self._odd_ns = self._odd_ns, None
        if stamp_ns > self._led_ns:
            self._led_ns = stamp_ns
            return (stamp_ns,)
        if odd_ns is not None and 0 < stamp_ns - odd_ns < 2 * PERIOD_NS:
            self._led_ns = stamp_ns
            return (odd_ns, stamp_ns)
        self._odd_ns = stamp_ns
        return ()

    def add_many(self, messages: Mapping[str, Sequence[bytes]], refuse: Refuse) -> None:
        """Take messages of the four data streams, with the outcome of `add` for each in turn.

        Parameters
        ----------
        messages : mapping of str to sequence of bytes
            By topic, each stream in its order.
        refuse : callable
            Called with topic and error for each message that is too short to have a stamp.
        """
        used = self._take_block(messages)
        for tick in range(used, max(map(len, messages.values()))):
            for topic in ORDER:
                if tick < len(messages[topic]):
                    try:
                        self.add(topic, messages[topic][tick])
                    except MalformedMessageError as error:
                        refuse(topic, error)

    def finish(self) -> None:
        """Complete the present trial with what there is, if its perturbation has begun."""
        if self._start_ns is not None:
            self._release_all()
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
        early, self._early = self._early, _nothing_early()
        for stamp_ns, topic, message in heapq.merge(*early.values(), key=lambda entry: entry[0]):
            self._accept(topic, message, stamp_ns)

    def _shorten(self, ticks: int) -> None:
        """End the trial earlier than planned; mostly told ahead of time."""
        self._end_ns -= (self._ticks - ticks) * PERIOD_NS
        self._ticks = ticks
        self._finished = self._finished or len(self._messages[PERTURBATION]) >= ticks
        if len(self._messages[PERTURBATION]) > ticks:
            self._give_back(ticks)

    def _give_back(self, ticks: int) -> None:
        """Let the next trial have what came before it was known that the present one was over."""
        led = [stamp_of(message) for message in self._messages[PERTURBATION]]
        self._up_to_ns = max(led[:ticks], default=-1)
        for topic, messages in self._messages.items():
            # Commands have no stamps, but those of the perturbations they came with.
            stamps = led if topic == COMMANDS else [stamp_of(message) for message in messages]
            timed = list(zip(stamps, messages, strict=False))
            self._messages[topic] = [raw for ns, raw in timed if ns <= self._up_to_ns]
            beyond = [(ns, topic, raw) for ns, raw in timed if ns > self._up_to_ns]
            self._early[topic].extendleft(reversed(beyond))

    def _accept(self, topic: str, message: bytes, stamp_ns: int) -> None:
        if self._start_ns is None:
            self._early[topic].append((stamp_ns, topic, message))
            return
        if stamp_ns < self._start_ns:
            return
        self._latest[topic] = stamp_ns
        if topic == PERTURBATION and not self._finished and stamp_ns < self._end_ns:
            self._lead(message, stamp_ns)
        elif topic != PERTURBATION and stamp_ns <= self._up_to_ns and not self._early[topic]:
            self._keep(topic, message, stamp_ns)
        else:
            # Behind those that wait, so that the order of arrival is kept.
            self._early[topic].append((stamp_ns, topic, message))
            self._finished = self._finished or topic == PERTURBATION
            if stamp_ns <= self._up_to_ns:
                self._release(topic)
        if self._finished:
            self._complete_if_all_there()

    def _take_block(self, messages: Mapping[str, Sequence[bytes]]) -> int:
        """Keep ticks of the present trial all at once where nothing is out of the ordinary.

        Returns how many.
        """
        in_step = not (self._commands or self._stamps_without_command or any(self._early.values()))
        if self._start_ns is None or self._finished or not in_step:
            return 0
        whole = block_of(messages)
        if whole is None or whole.stamps[0] < self._start_ns or whole.stamps[0] <= self._up_to_ns:
            return 0
        block = whole.first(self._ticks - len(self._messages[PERTURBATION]))
        if block.stamps[-1] >= self._end_ns:
            return 0
        for topic in DATA_STREAMS:
            self._messages[topic] += block.messages[topic]
        self._up_to_ns = self._led_ns = block.stamps[-1]
        self._latest = dict.fromkeys(DATA_STREAMS, self._up_to_ns)
        self._finished = len(self._messages[PERTURBATION]) >= self._ticks
        self._sink_block(block)
        if self._finished:
            self._complete_if_all_there()
        return block.ticks

    def _sink_block(self, block: SampleBatch) -> None:
        if self._block_sink is not None:
            self._block_sink(block)
            return
        for tick, stamp_ns in enumerate(block.stamps):
            for topic in ORDER:
                self._sink(topic, block.messages[topic][tick], stamp_ns)

    def _lead(self, message: bytes, stamp_ns: int) -> None:
        """A perturbation extends the trial up to its stamp."""
        self._up_to_ns = max(stamp_ns, self._up_to_ns)
        for topic in _FOLLOWERS:
            self._release(topic)
        self._keep(PERTURBATION, message, stamp_ns)
        self._finished = len(self._messages[PERTURBATION]) >= self._ticks

    def _release(self, topic: str) -> None:
        """Keep what has waited for the perturbation to come up to its stamp, in its order."""
        waiting = self._early[topic]
        while waiting:
            if waiting[0][0] <= self._up_to_ns:
                early_ns, _, early = waiting.popleft()
                self._keep(topic, early, early_ns)
            elif len(waiting) > 1 and waiting[0][0] - waiting[1][0] > _ASTRAY_NS:
                waiting.rotate(-1)
            else:
                return

    def _release_all(self) -> None:
        """Keep what belongs to the trial and waits behind samples that came after its end."""
        for topic in _FOLLOWERS:
            waiting = list(self._early[topic])
            self._early[topic].clear()
            for early_ns, _, early in waiting:
                if early_ns <= self._up_to_ns:
                    self._keep(topic, early, early_ns)
                else:
                    self._early[topic].append((early_ns, topic, early))

    def _keep(self, topic: str, message: bytes, stamp_ns: int) -> None:
        self._messages[topic].append(message)
        self._sink(topic, message, stamp_ns)

    def _complete_if_all_there(self) -> None:
        if not (self._finished and self._left):
            return
        overdue = self._latest[PERTURBATION] >= self._end_ns + _OVERDUE_NS
        if overdue or all(self._latest[topic] >= self._up_to_ns for topic in DATA_STREAMS):
            self.finish()


def _nothing_early() -> dict[str, deque[tuple[int, str, bytes]]]:
    return {topic: deque(maxlen=_KEPT_EARLY) for topic in DATA_STREAMS}
