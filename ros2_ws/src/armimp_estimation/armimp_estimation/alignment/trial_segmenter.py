"""Picking the samples of one trial after another out of the live streams.

Streams and statuses arrive interleaved in any way, each in its own order. The perturbation leads:
a trial is its first ``ticks`` messages from ``start_ns`` on, the sensor samples up to the same
stamps, and the commands of the same ordinal numbers, since every tick has one of each.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from operator import itemgetter, lt

from armimp_common.cdr import stamp_of
from armimp_common.errors import MalformedMessageError
from armimp_common.status import Phase, TrialStatus
from armimp_common.topics import (
    COMMANDS,
    DATA_STREAMS,
    JOINT_STATES,
    NS_PER_S,
    PERIOD_NS,
    PERTURBATION,
    TORQUE_SENSORS,
)
from armimp_estimation.alignment.streams import Streams

Sink = Callable[[Sequence[int], Mapping[str, Sequence[bytes]]], None]
"""Takes stamps (ns) and a message for each of them, by topic of the contract."""
Refuse = Callable[[str, MalformedMessageError], None]

ORDER = (JOINT_STATES, TORQUE_SENSORS, PERTURBATION, COMMANDS)
"""Messages of a tick in the order in which they are recorded."""

_FOLLOWERS = (JOINT_STATES, TORQUE_SENSORS, COMMANDS)
_KEPT_EARLY = 30_000
"""Messages of each stream that may be ahead of a status, or of the other streams."""
_DRIFT = 2e-4
"""By how much the clock of a driver may go wrong relative to the nominal period."""
_ASTRAY_NS = 1_000_000_000
"""A stamp so far (ns) ahead of the next one of its stream is wrong: nothing waits for its time."""
_OVERDUE_NS = 2_000_000_000
"""So long after the planned end (ns), whatever is missing is lost: queues hold no more."""
_HEAD = struct.Struct("<4siI")
"""Beginning of a message with a ``std_msgs/Header``: encapsulation and stamp."""
_LITTLE_ENDIAN = b"\0\1\0\0"
_head_of = itemgetter(slice(_HEAD.size))


class TrialSegmenter:
    """Collects the samples of the present trial and passes each message on as it is accepted.

    Parameters
    ----------
    joint_names : sequence of str
        Order of the joints.
    sink : callable
        Called with accepted messages: one, or those of many ticks at once.
    on_complete : callable
        Called with statuses and streams of each trial when it is complete, or as complete as it
        will get.
    on_begin : callable
        Called with the first status of each trial.
    """

    def __init__(
        self,
        joint_names: Sequence[str],
        sink: Sink,
        on_complete: Callable[[Sequence[TrialStatus], Streams], None],
        on_begin: Callable[[TrialStatus], None] = lambda _: None,
    ) -> None:
        self._names = joint_names
        self._sink, self._on_complete, self._on_begin = sink, on_complete, on_begin
        self._waiting_statuses: deque[TrialStatus] = deque()
        self._commands: deque[bytes] = deque()
        self._unanswered: deque[int] = deque()
        """Stamps of perturbations whose command has not come."""
        self._led_ns = -1
        self._odd_ns: int | None = None
        self._queues = {topic: _queue() for topic in DATA_STREAMS}
        """Stamps and messages that no trial has or has passed over."""
        self._forget()

    @property
    def status(self) -> TrialStatus | None:
        """Last status of the present trial; None between trials."""
        return self.statuses[-1] if self.statuses else None

    @property
    def samples(self) -> int:
        """Number of complete samples of the present trial so far."""
        return min(map(self.streams.count, DATA_STREAMS))

    def _forget(self) -> None:
        self.statuses: list[TrialStatus] = []
        """Statuses of the present trial so far."""
        self.streams = Streams(self._names)
        """What has been accepted so far in the present trial."""
        self._start_ns: int | None = None
        self._ticks = self._end_ns = 0
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
        self.statuses.append(status)
        if status.phase is Phase.PERTURB and self._start_ns is None:
            self._begin(status)
        elif self._start_ns is not None and status.ticks < self._ticks:
            # Mostly announced ahead of time; what has come beyond belongs to the rest after it.
            self._end_ns -= (self._ticks - status.ticks) * PERIOD_NS
            self._ticks = status.ticks
            self._finished = self._finished or self._led >= status.ticks
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
            self._commands.append(message)
        else:
            stamp_ns = stamp_of(message)
            self._enqueue(topic, stamp_ns, message)
            if topic == PERTURBATION:
                self._unanswered += self._answered(stamp_ns)
        while self._commands and self._unanswered:
            self._enqueue(COMMANDS, self._unanswered.popleft(), self._commands.popleft())
        self._go_on()

    def _enqueue(self, topic: str, stamp_ns: int, message: bytes) -> None:
        self._queues[topic].append((stamp_ns, message))
        self._latest[topic] = stamp_ns

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
        used = self._take_together(messages)
        for tick in range(used, max(map(len, messages.values()))):
            for topic in ORDER:
                if tick < len(messages[topic]):
                    try:
                        self.add(topic, messages[topic][tick])
                    except MalformedMessageError as error:
                        refuse(topic, error)

    def finish(self) -> None:
        """Complete the present trial with what there is, if its perturbation has begun."""
        begun = self._start_ns is not None
        for topic in _FOLLOWERS if begun else ():
            # Some wait behind samples that came after the end.
            queue, self._queues[topic] = self._queues[topic], _queue()
            for stamp_ns, message in queue:
                if stamp_ns <= self._up_to_ns:
                    self._keep(topic, message, stamp_ns)
                else:
                    self._queues[topic].append((stamp_ns, message))
        statuses, streams = self.statuses, self.streams
        self._forget()
        if begun:
            self._on_complete(statuses, streams)
        waiting, self._waiting_statuses = self._waiting_statuses, deque()
        for status in waiting:
            self.add_status(status)

    def _begin(self, status: TrialStatus) -> None:
        assert status.start_ns is not None
        self._start_ns, self._ticks = status.start_ns, status.ticks
        planned = status.ticks * PERIOD_NS
        self._end_ns = status.start_ns + planned + int(planned * _DRIFT) - PERIOD_NS // 2
        self._up_to_ns = status.start_ns - 1
        for topic, queue in self._queues.items():
            self._latest[topic] = queue[-1][0] if queue else -1
        self._go_on()

    @property
    def _led(self) -> int:
        return self.streams.count(PERTURBATION)

    def _go_on(self) -> None:
        """Keep what belongs to the trial as far as its perturbation has come."""
        if self._start_ns is None:
            return
        leading = self._queues[PERTURBATION]
        while leading and not self._finished:
            stamp_ns, message = leading[0]
            if stamp_ns >= self._end_ns:
                self._finished = True
                break
            leading.popleft()
            if stamp_ns >= self._start_ns:
                self._up_to_ns = max(stamp_ns, self._up_to_ns)
                for topic in (JOINT_STATES, TORQUE_SENSORS):
                    self._follow(topic)
                self._keep(PERTURBATION, message, stamp_ns)
                self._follow(COMMANDS)
                self._finished = self._led >= self._ticks
        for topic in _FOLLOWERS:
            self._follow(topic)
        self._complete_if_all_there()

    def _follow(self, topic: str) -> None:
        """Keep what has waited for the perturbation to come up to its stamp, in its order."""
        waiting = self._queues[topic]
        while waiting:
            stamp_ns, message = waiting[0]
            if stamp_ns <= self._up_to_ns:
                waiting.popleft()
                self._keep(topic, message, stamp_ns)
            elif len(waiting) > 1 and stamp_ns - waiting[1][0] > _ASTRAY_NS:
                waiting.rotate(-1)
            else:
                return

    def _take_together(self, messages: Mapping[str, Sequence[bytes]]) -> int:
        """Keep ticks of the present trial all at once where nothing is out of the ordinary.

        Returns how many.
        """
        in_step = not (self._commands or self._unanswered or any(self._queues.values()))
        if self._start_ns is None or self._finished or not in_step:
            return 0
        stamps = stamps_in_step(messages)[: self._ticks - self._led]
        if not stamps or stamps[0] < self._start_ns or stamps[0] <= self._up_to_ns:
            return 0
        if stamps[-1] >= self._end_ns:
            return 0
        kept = {topic: messages[topic][: len(stamps)] for topic in ORDER}
        for topic, raws in kept.items():
            self.streams.add(topic, raws)
        self._up_to_ns = self._led_ns = stamps[-1]
        self._latest = dict.fromkeys(DATA_STREAMS, self._up_to_ns)
        self._finished = self._led >= self._ticks
        self._sink(stamps, kept)
        self._complete_if_all_there()
        return len(stamps)

    def _keep(self, topic: str, message: bytes, stamp_ns: int) -> None:
        """Keep a message unless it is from before the trial."""
        if self._start_ns is not None and stamp_ns >= self._start_ns:
            self.streams.add(topic, (message,))
            self._sink((stamp_ns,), {topic: (message,)})

    def _complete_if_all_there(self) -> None:
        if not (self._finished and self._left):
            return
        overdue = self._latest[PERTURBATION] >= self._end_ns + _OVERDUE_NS
        if overdue or all(self._latest[topic] >= self._up_to_ns for topic in DATA_STREAMS):
            self.finish()


def stamps_in_step(messages: Mapping[str, Sequence[bytes]]) -> list[int]:
    """Stamps (ns) of messages of the four streams that are those of ticks one after the other.

    Plain Python on purpose. Once in fifty ticks nothing of numpy is in the processor's caches, and
    a few of its operations take longer than a loop of the interpreter, which is.

    Returns
    -------
    list of int
        Rising and none of them negative; empty if the streams are not in step, or the messages of
        one are not of equal length: then each has to be looked at for itself.
    """
    count = len(messages[PERTURBATION])
    if not count:
        return []
    for topic in DATA_STREAMS:
        raws = messages[topic]
        if len(raws) != count or len(set(map(len, raws))) != 1:
            return []
    heads, states, sensors = (
        list(map(_head_of, messages[topic]))
        for topic in (PERTURBATION, JOINT_STATES, TORQUE_SENSORS)
    )
    if len(heads[0]) != _HEAD.size or not heads == states == sensors:
        return []
    stamps: list[int] = []
    for head, seconds, nanoseconds in _HEAD.iter_unpack(b"".join(heads)):
        if head != _LITTLE_ENDIAN:
            return []
        stamps.append(seconds * NS_PER_S + nanoseconds)
    return stamps if stamps[0] >= 0 and all(map(lt, stamps, stamps[1:])) else []


def _queue() -> deque[tuple[int, bytes]]:
    return deque(maxlen=_KEPT_EARLY)
