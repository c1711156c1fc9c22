"""The samples of a recording: each message is decoded once, into arrays that grow."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from contextlib import suppress
from operator import lt

import numpy as np
from numpy.typing import NDArray

from armimp_common.arrays import BoolArray, FloatArray, IntArray
from armimp_common.cdr import CommandDecoder, JointStateDecoder, command_number, joint_names_of
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
"""Messages that wait until they are decoded at once, which is far cheaper than one by one."""
_HEAD = struct.Struct("<4siI")
"""Beginning of a message with a ``std_msgs/Header``: encapsulation and stamp."""
_LITTLE_ENDIAN = b"\0\1\0\0"


class Stream:
    """The numbers of one topic in order of arrival.

    Parameters
    ----------
    joints : int
        Their number n.
    """

    def __init__(self, joints: int) -> None:
        self._stamps, self._values = np.empty(0, np.int64), np.empty((joints, 0))
        self.count = 0
        """Number N of messages so far."""
        self.malformed = 0
        """Messages with a stamp that were left out because they could not be decoded."""
        self.defect = ""
        """What is wrong with the first that could not be decoded."""

    @property
    def stamps(self) -> IntArray:
        """Stamps (ns), (N,); of commands, which have none, their numbers, 0 for none."""
        return self._stamps[: self.count]

    @property
    def values(self) -> FloatArray:
        """Numbers of the joints in SI units, (n, N)."""
        return self._values[:, : self.count]

    def append(self, stamps: IntArray, values: FloatArray) -> None:
        """Add messages, which have come after all others."""
        end = self.count + stamps.size
        if end > self._stamps.size:
            room = max(end, 2 * self._stamps.size)
            grown_stamps, grown = np.empty(room, np.int64), np.empty((len(self._values), room))
            grown_stamps[: self.count], grown[:, : self.count] = self.stamps, self.values
            self._stamps, self._values = grown_stamps, grown
        self._stamps[self.count : end], self._values[:, self.count : end] = stamps, values
        self.count = end

    def ordered(self) -> tuple[IntArray, NDArray[np.intp], BoolArray]:
        """The messages in the order of their stamps, without repetitions.

        Returns
        -------
        stamps : ndarray, shape (M,)
            Ascending, ns.
        order : ndarray, shape (M,)
            Index of the first message with each stamp.
        contradicted : ndarray, shape (M,)
            Whether another one with the same stamp has other numbers.
        """
        if (np.diff(self.stamps) > 0).all():
            return self.stamps, np.arange(self.count), np.zeros(self.count, np.bool_)
        stamps, order, place = np.unique(self.stamps, return_index=True, return_inverse=True)
        first = self.values[:, order[place]]
        same = (self.values == first) | (np.isnan(self.values) & np.isnan(first))
        contradicted = np.zeros(stamps.size, np.bool_)
        contradicted[place[~same.all(axis=0)]] = True
        return stamps, order, contradicted


class Streams:
    """The four streams of a trial or of a recording.

    All streams must begin with the same control period, as commands have no stamps.

    Parameters
    ----------
    joint_names : sequence of str
        Order of the rows of all values; messages may have any other. Those of sensors may have
        further joints, which are passed over, but for their angles.
    """

    def __init__(self, joint_names: Sequence[str]) -> None:
        n = len(joint_names)
        self.joint_names = tuple(joint_names)
        self.stamped = {topic: Stream(n) for topic in VALUE_FIELD}
        """Positions (rad), torque readings and perturbation (N·m), by topic of the contract."""
        self.commands = Stream(n)
        """Commands (N·m), in the order of the joints."""
        self.further: dict[str, Stream] = {}
        """Angles of further joints by name, rad; nobody perturbs these, so they must not move."""
        self._no_command = (np.nan,) * n
        self._streams = {**self.stamped, COMMANDS: self.commands}
        self._pending: dict[str, list[bytes]] = {topic: [] for topic in self._streams}
        self._decoders: dict[str, JointStateDecoder | CommandDecoder] = {
            # Those of all joints of a robot may be published together, but the perturbed are known.
            topic: JointStateDecoder(joint_names, field, others=topic != PERTURBATION)
            for topic, field in VALUE_FIELD.items()
        }
        self._decoders[COMMANDS] = CommandDecoder(n)

    def add(self, topic: str, messages: Sequence[bytes]) -> None:
        """Take serialised messages of a topic of the contract, in order of arrival."""
        pending = self._pending[topic]
        pending += messages
        if len(pending) >= _DECODED_TOGETHER:
            self._decode(topic)

    def count(self, topic: str) -> int:
        """Number of messages so far, malformed ones included."""
        stream = self._streams[topic]
        return stream.count + stream.malformed + len(self._pending[topic])

    def decode(self) -> Streams:
        """Decode what has not been decoded yet."""
        for topic in self._pending:
            self._decode(topic)
        return self

    def _decode(self, topic: str) -> None:
        messages, self._pending[topic] = self._pending[topic], []
        if not messages:
            return
        stream, decoder = self._streams[topic], self._decoders[topic]
        try:
            stream.append(*decoder.decode_many(messages))
        except MalformedMessageError:
            for message in messages:
                try:
                    number, values = decoder.decode(message)
                except MalformedMessageError as error:
                    stream.defect = stream.defect or str(error)
                    if topic != COMMANDS:
                        stream.malformed += 1
                        continue
                    # It keeps its place, since a missing one would shift all those after it.
                    number, values = command_number(message), self._no_command
                stream.append(np.array([number]), np.array(values)[:, None])
        if topic == JOINT_STATES:
            self._follow_further(messages)

    def _follow_further(self, messages: Sequence[bytes]) -> None:
        """Take the angles of further joints, where all messages have those of the first."""
        with suppress(MalformedMessageError):
            for name in filter(None, set(joint_names_of(messages[0])).difference(self.joint_names)):
                decoded = JointStateDecoder((name,), "position", others=True).decode_many(messages)
                self.further.setdefault(name, Stream(1)).append(*decoded)


def decode_streams(joint_names: Sequence[str], messages: Mapping[str, Sequence[bytes]]) -> Streams:
    """Decode the serialised messages of a recording, by topic of the contract.

    Raises
    ------
    DataError
        If a stream has no message that can be decoded.
    """
    streams = Streams(joint_names)
    for topic in (*VALUE_FIELD, COMMANDS):
        streams.add(topic, messages.get(topic, ()))
    for topic, stream in streams.decode().stamped.items():
        if not stream.count:
            raise DataError(
                f"{topic}: none of {stream.malformed} messages can be decoded: {stream.defect}"
            )
    return streams


def stamps_in_step(messages: Mapping[str, Sequence[bytes]], after_ns: int = -1) -> list[int]:
    """Stamps (ns) of messages of the four streams that are those of ticks one after the other.

    This is plain Python on purpose: it is called once in fifty ticks, when the code of numpy has
    left the caches of the processor, and a few of its operations take longer than this loop.

    Returns
    -------
    list of int
        Rising from above `after_ns` on; empty if the streams are not in step: then each message
        has to be looked at for itself.
    """
    count = len(messages.get(PERTURBATION, ()))
    if not count or any(len(messages.get(topic, ())) != count for topic in DATA_STREAMS):
        return []
    heads, states, sensors = (
        [message[: _HEAD.size] for message in messages[topic]]
        for topic in (PERTURBATION, JOINT_STATES, TORQUE_SENSORS)
    )
    if not heads == states == sensors or set(map(len, heads)) != {_HEAD.size}:
        return []
    stamps: list[int] = []
    for head, seconds, nanoseconds in _HEAD.iter_unpack(b"".join(heads)):
        if head != _LITTLE_ENDIAN:
            return []
        stamps.append(seconds * NS_PER_S + nanoseconds)
    return stamps if stamps[0] > after_ns and all(map(lt, stamps, stamps[1:])) else []
