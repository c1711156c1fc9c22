"""The samples of a recording: each message is decoded once, into growing arrays."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from contextlib import suppress
from operator import lt

import numpy as np
from numpy.typing import NDArray

from armimp_common.arrays import BoolArray, FloatArray, IntArray
from armimp_common.cdr import (
    LITTLE,
    JointStateDecoder,
    command_number,
    decoder_of,
    joint_names_of,
)
from armimp_common.errors import DataError, MalformedMessageError
from armimp_common.topics import (
    COMMANDS,
    DATA_STREAMS,
    JOINT_STATES,
    NS_PER_S,
    PERTURBATION,
    TORQUE_SENSORS,
    VALUE_FIELD,
)

_DECODED_TOGETHER = 1000
"""Messages that are decoded as a block, which is far cheaper than one by one."""
_HEAD = struct.Struct("<4siI")
"""Beginning of a message with a ``std_msgs/Header``: encapsulation and stamp."""


class Stream:
    """The values of one topic in order of arrival.

    Parameters
    ----------
    topic : str
        Topic of the contract.
    joint_names : sequence of str
        Order of the rows of all values; messages may use any other order. Messages of sensors may
        have further joints, of which only the angles are kept, in `further`.
    """

    def __init__(self, topic: str, joint_names: Sequence[str]) -> None:
        n = len(joint_names)
        self._stamps, self._values = np.empty(0, np.int64), np.empty((n, 0))
        self._pending: list[bytes] = []
        self._topic, self._joint_names = topic, tuple(joint_names)
        self._stamped = topic != COMMANDS
        # Sensors may publish all joints of a robot, but perturbations only have known joints.
        self._decoder = decoder_of(topic, joint_names, others=topic != PERTURBATION)
        self.further: dict[str, Stream] = {}
        """Angles of further joints by name, rad. These are not perturbed, so they must not move."""
        self.count = 0
        """Number N of messages decoded so far."""
        self.malformed = 0
        """Messages of a topic with stamps that were left out because they can't be decoded."""
        self.defect = ""
        """What is wrong with the first message that can't be decoded."""

    @property
    def received(self) -> int:
        """Number of messages so far, malformed ones included."""
        return self.count + self.malformed + len(self._pending)

    def add(self, messages: Sequence[bytes]) -> None:
        """Add serialised messages, in order of arrival."""
        self._pending += messages
        if len(self._pending) >= _DECODED_TOGETHER:
            self.decode()

    def decode(self) -> None:
        """Decode all pending messages."""
        messages, self._pending = self._pending, []
        if not messages:
            return
        try:
            self.append(*self._decoder.decode_many(messages))
        except MalformedMessageError:
            for message in messages:
                try:
                    number, values = self._decoder.decode(message)
                except MalformedMessageError as error:
                    self.defect = self.defect or str(error)
                    if self._stamped:
                        self.malformed += 1
                        continue
                    # A command keeps its place, since a missing one would shift all later ones.
                    number, values = command_number(message), (np.nan,) * len(self._values)
                self.append(np.array([number]), np.array(values)[:, None])
        if self._topic == JOINT_STATES:
            self._follow_further(messages)

    def _follow_further(self, messages: Sequence[bytes]) -> None:
        """Decode the angles of further joints, if every message has those of the first message."""
        with suppress(MalformedMessageError):
            others = set(joint_names_of(messages[0])).difference(self._joint_names)
            for name in filter(None, others):
                decoded = JointStateDecoder((name,), "position", others=True).decode_many(messages)
                self.further.setdefault(name, Stream(JOINT_STATES, (name,))).append(*decoded)

    @property
    def stamps(self) -> IntArray:
        """Stamps (ns), (N,); of commands, which have none, the sequence numbers (0: no number)."""
        return self._stamps[: self.count]

    @property
    def values(self) -> FloatArray:
        """Values of the joints in SI units, (n, N)."""
        return self._values[:, : self.count]

    def append(self, stamps: IntArray, values: FloatArray) -> None:
        """Append decoded messages, which arrived after all others."""
        end = self.count + stamps.size
        if end > self._stamps.size:
            room = max(end, 2 * self._stamps.size)
            grown_stamps, grown = np.empty(room, np.int64), np.empty((len(self._values), room))
            grown_stamps[: self.count], grown[:, : self.count] = self.stamps, self.values
            self._stamps, self._values = grown_stamps, grown
        self._stamps[self.count : end], self._values[:, self.count : end] = stamps, values
        self.count = end

    def ordered(self) -> tuple[IntArray, NDArray[np.intp], BoolArray]:
        """Sort the messages by their stamps, without repetitions.

        Returns
        -------
        stamps : ndarray, shape (M,)
            Ascending, ns.
        order : ndarray, shape (M,)
            Index of the first message with each stamp.
        contradicted : ndarray, shape (M,)
            Whether another message with the same stamp has different values.
        """
        if (np.diff(self.stamps) > 0).all():
            return self.stamps, np.arange(self.count), np.zeros(self.count, np.bool_)
        stamps, order, place = np.unique(self.stamps, return_index=True, return_inverse=True)
        first = self.values[:, order[place]]
        same = (self.values == first) | (np.isnan(self.values) & np.isnan(first))
        contradicted = np.zeros(stamps.size, np.bool_)
        contradicted[place[~same.all(axis=0)]] = True
        return stamps, order, contradicted


class Streams(dict[str, Stream]):
    """The four streams of a trial or of a recording, by topic of the contract.

    All streams must begin with the same control period, as commands have no stamps.

    Parameters
    ----------
    joint_names : sequence of str
        As in :class:`Stream`.
    """

    def __init__(self, joint_names: Sequence[str]) -> None:
        super().__init__({topic: Stream(topic, joint_names) for topic in DATA_STREAMS})
        self.joint_names = tuple(joint_names)
        self.stamped = {topic: self[topic] for topic in VALUE_FIELD}
        """Positions (rad), torque readings and perturbation (N·m)."""
        self.commands = self[COMMANDS]
        """Commands (N·m), in the order of the joints."""

    def decode(self) -> Streams:
        """Decode all pending messages."""
        for stream in self.values():
            stream.decode()
        return self


def decode_streams(joint_names: Sequence[str], messages: Mapping[str, Sequence[bytes]]) -> Streams:
    """Decode the serialised messages of a recording, by topic of the contract.

    Raises
    ------
    DataError
        If a stream has no message that can be decoded.
    """
    streams = Streams(joint_names)
    for topic, stream in streams.items():
        stream.add(messages.get(topic, ()))
    for topic, stream in streams.decode().stamped.items():
        if not stream.count:
            raise DataError(
                f"{topic}: none of {stream.malformed} messages can be decoded: {stream.defect}"
            )
    return streams


def stamps_in_step(messages: Mapping[str, Sequence[bytes]], after_ns: int = -1) -> list[int]:
    """Stamps (ns) of the ticks of messages, if the four streams are in step.

    They are in step if each has one message per tick, all of one length, with one stamp per tick.

    Plain Python, as this is called once in fifty ticks, when the code of numpy has left the caches
    of the processor: a few numpy operations would take longer than this loop.

    Returns
    -------
    list of int
        Rising stamps, all above `after_ns`; empty if the streams are not in step, so that each
        message has to be examined by itself.
    """
    count = len(messages.get(PERTURBATION, ()))
    if not count or any(len(messages.get(topic, ())) != count for topic in DATA_STREAMS):
        return []
    if any(len(set(map(len, messages[topic]))) != 1 for topic in DATA_STREAMS):
        return []
    heads, states, sensors = (
        [message[: _HEAD.size] for message in messages[topic]]
        for topic in (PERTURBATION, JOINT_STATES, TORQUE_SENSORS)
    )
    if not heads == states == sensors or len(heads[0]) != _HEAD.size:
        return []
    stamps: list[int] = []
    for head, seconds, nanoseconds in _HEAD.iter_unpack(b"".join(heads)):
        if head != LITTLE:
            return []
        stamps.append(seconds * NS_PER_S + nanoseconds)
    return stamps if stamps[0] > after_ns and all(map(lt, stamps, stamps[1:])) else []
