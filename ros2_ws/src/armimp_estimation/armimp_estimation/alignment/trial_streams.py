"""The streams of a recording, decoded in the order in which their messages arrived."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from armimp_common import topics
from armimp_common.cdr import CommandDecoder, JointStateDecoder, command_number
from armimp_common.errors import DataError, MalformedMessageError


@dataclass(frozen=True, kw_only=True, eq=False)
class Stream:
    """Decoded messages of one topic with stamps.

    Parameters
    ----------
    stamps : ndarray, shape (N,)
        Header stamps (ns) in order of arrival.
    values : ndarray, shape (n, N)
        Numbers of the joints, in SI units.
    malformed : int
        Messages that were left out because they could not be decoded.
    defect : str
        What is wrong with the first of those.
    """

    stamps: NDArray[np.int64]
    values: NDArray[np.float64]
    malformed: int = 0
    defect: str = ""

    @cached_property
    def ordered(self) -> tuple[NDArray[np.int64], NDArray[np.intp], NDArray[np.bool_]]:
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
            count = self.stamps.size
            return self.stamps, np.arange(count), np.zeros(count, np.bool_)
        stamps, order, place = np.unique(self.stamps, return_index=True, return_inverse=True)
        first = self.values[:, order[place]]
        same = (self.values == first) | (np.isnan(self.values) & np.isnan(first))
        contradicted = np.zeros(stamps.size, np.bool_)
        contradicted[place[~same.all(axis=0)]] = True
        return stamps, order, contradicted


@dataclass(frozen=True, kw_only=True, eq=False)
class TrialStreams:
    """What a trial is assembled from.

    Parameters
    ----------
    joint_names : tuple of str
        Order of the rows of all values.
    stamped : mapping of str to Stream
        Positions (rad), torque readings and perturbation (N·m), by topic of the contract.
    commands : int
        Number of command messages.
    command_values : ndarray, shape (n, commands), or None
        Commands in order of arrival, N·m; None unless all can be decoded. They have no stamps, and
        are taken to be in the order of `joint_names`.
    command_numbers : ndarray, shape (commands,)
        The number that each of them carries, 0 for none.
    """

    joint_names: tuple[str, ...]
    stamped: Mapping[str, Stream]
    commands: int
    command_values: NDArray[np.float64] | None = None
    command_numbers: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))


def decode_streams(
    joint_names: Sequence[str], messages: Mapping[str, Sequence[bytes]]
) -> TrialStreams:
    """Decode the raw messages of a recording.

    Parameters
    ----------
    joint_names : sequence of str
        Order of the joints; messages may have any other.
    messages : mapping of str to sequence of bytes
        By topic of the contract, the serialised messages in order of arrival. All streams must
        begin with the same control period.

    Raises
    ------
    DataError
        If a stream has no message that can be decoded.
    """
    commands = messages.get(topics.COMMANDS, ())
    return TrialStreams(
        joint_names=tuple(joint_names),
        stamped={
            topic: _decode(topic, JointStateDecoder(joint_names, field), messages.get(topic, ()))
            for topic, field in topics.VALUE_FIELD.items()
        },
        commands=len(commands),
        command_values=_decode_commands(len(joint_names), commands),
        command_numbers=numbers_of(commands),
    )


def numbers_of(commands: Sequence[bytes]) -> NDArray[np.int64]:
    """Return the number that each command carries, 0 for none."""
    return np.fromiter(map(command_number, commands), np.int64, len(commands))


def _decode_commands(joints: int, messages: Sequence[bytes]) -> NDArray[np.float64] | None:
    """Decode all commands or none, as a missing one would shift those after it."""
    try:
        return CommandDecoder(joints).decode_many(messages)
    except MalformedMessageError:
        return None


def _decode(topic: str, decoder: JointStateDecoder, messages: Sequence[bytes]) -> Stream:
    if not messages:
        raise DataError(f"no messages of {topic}")
    try:
        stamps, values = decoder.decode_many(messages)
    except MalformedMessageError:
        return _decode_one_by_one(topic, decoder, messages)
    return Stream(stamps=stamps, values=values)


def _decode_one_by_one(topic: str, decoder: JointStateDecoder, messages: Sequence[bytes]) -> Stream:
    decoded: list[tuple[int, tuple[float, ...]]] = []
    defect = ""
    for message in messages:
        try:
            decoded.append(decoder.decode(message))
        except MalformedMessageError as error:
            defect = defect or str(error)
    if not decoded:
        raise DataError(f"{topic}: none of {len(messages)} messages can be decoded: {defect}")
    return Stream(
        stamps=np.array([stamp for stamp, _ in decoded], np.int64),
        values=np.ascontiguousarray(np.array([values for _, values in decoded], np.float64).T),
        malformed=len(messages) - len(decoded),
        defect=defect,
    )
