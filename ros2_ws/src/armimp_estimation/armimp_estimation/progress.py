"""Running figures of the trial that is being recorded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from armimp_common.cdr import CommandDecoder, JointStateDecoder
from armimp_common.errors import DataError, MalformedMessageError
from armimp_common.topics import (
    COMMANDS,
    JOINT_STATES,
    PERIOD_NS,
    PERTURBATION,
    TORQUE_SENSORS,
    VALUE_FIELD,
)
from armimp_estimation.alignment.trial_streams import Stream, TrialStreams, numbers_of
from armimp_estimation.estimators.lpm import FittedColumn, LpmFull
from armimp_estimation.record import TrialRecord
from armimp_estimation.scores import coherence
from armimp_estimation.spectra import WelchConfig
from armimp_estimation.trial import TrialAccumulator

_STREAMS = (PERTURBATION, JOINT_STATES, TORQUE_SENSORS)

Messages = Mapping[str, list[bytes]]


class RunningTrial:
    """What the samples recorded so far tell, for people who watch and to know when it is enough.

    Parameters
    ----------
    joint_names : tuple of str
        Names of the n joints.
    joint : int
        Perturbed joint, 0-based.
    rate : float
        Samples per second, Hz.
    planned : int
        Samples that the trial will have.
    trial : int
        Its number, 1-based.
    lpm : LpmFull, optional
        The estimator of the column.
    others : sequence of TrialRecord
        Trials before this one.
    """

    def __init__(
        self,
        joint_names: tuple[str, ...],
        joint: int,
        *,
        rate: float,
        planned: int,
        trial: int = 1,
        lpm: LpmFull | None = None,
        others: Sequence[TrialRecord] = (),
    ) -> None:
        self._names = joint_names
        self._others = others
        self._joint = joint
        self._rate = rate
        self._trial = trial
        self._lpm = lpm if lpm is not None else LpmFull()
        self._decoders = {
            topic: JointStateDecoder(joint_names, VALUE_FIELD[topic]) for topic in _STREAMS
        }
        self._command_decoder = CommandDecoder(len(joint_names))
        self._accumulator = TrialAccumulator(
            len(joint_names), joint, rate, WelchConfig.for_samples(planned)
        )
        self._used = 0
        self._values = {topic: _Rows(len(joint_names)) for topic in (*_STREAMS, COMMANDS)}
        self._stamps: dict[str, list[NDArray[np.int64]]] = {topic: [] for topic in _STREAMS}
        self._last_ns: int | None = None
        self._in_step = True

    def update(self, messages: Messages) -> tuple[float, float] | None:
        """Take in what has come since the last call.

        Parameters
        ----------
        messages : mapping of str to list of bytes
            All accepted messages of the trial so far, by topic.

        Returns
        -------
        (motion, torque) or None
            Band means of γ²(τΔ, θ_k) and γ²(τΔ, τ_k); None until there are two segments, and after
            a message that cannot be used (which the final account will name).
        """
        try:
            self._take(messages)
            if self._accumulator.segments < 2:
                return None
            trial = self._accumulator.result()
            k = self._joint
            motion = np.mean(coherence(trial.spectra, 0, trial.position_channel(k)))
            torque = np.mean(coherence(trial.spectra, 0, trial.torque_channel(k)))
        except (MalformedMessageError, DataError):
            return None
        return float(motion), float(torque)

    def column(self, messages: Messages, samples: int | None = None) -> FittedColumn | None:
        """Column k of M, B and K with standard errors, as :meth:`LpmFull.column` gives it.

        Parameters
        ----------
        messages : mapping of str to list of bytes
            As for :meth:`update`.
        samples : int, optional
            How many samples to use, from the first on; by default all that are there.

        Returns
        -------
        FittedColumn or None
            None where the samples are too few, or one is missing or cannot be used.
        """
        try:
            self._take(messages)
            count = self._used if samples is None else samples
            if not self._in_step or not 0 < count <= self._used:
                return None
            commands = self._values[COMMANDS]
            return self._lpm.column(
                TrialRecord(
                    trial=self._trial,
                    perturbed_joint=self._joint,
                    rate=self._rate,
                    joint_names=self._names,
                    perturbation=self._values[PERTURBATION].first(count),
                    position=self._values[JOINT_STATES].first(count),
                    torque=self._values[TORQUE_SENSORS].first(count),
                    start_ns=0,
                    seed=None,
                    command=commands.first(count) if commands.count >= count else None,
                ),
                self._others,
            )
        except (MalformedMessageError, DataError):
            return None

    def streams(self, messages: Messages) -> TrialStreams | None:
        """The decoded messages of the whole trial, as `decode_streams` would return them.

        Returns
        -------
        TrialStreams or None
            None unless each message could be used and the streams with stamps have equally many.
        """
        try:
            self._take(messages)
        except (MalformedMessageError, DataError):
            return None
        taken = {topic: rows.count for topic, rows in self._values.items()}
        if not self._used or {topic: len(messages[topic]) for topic in taken} != taken:
            return None
        values = {topic: rows.first(rows.count).copy() for topic, rows in self._values.items()}
        return TrialStreams(
            joint_names=self._names,
            stamped={
                # In the order of `decode_streams`, on which that of problems depends.
                topic: Stream(stamps=np.concatenate(self._stamps[topic]), values=values[topic])
                for topic in VALUE_FIELD
            },
            commands=taken[COMMANDS],
            command_values=values[COMMANDS],
            command_numbers=numbers_of(messages[COMMANDS]),
        )

    def _take(self, messages: Messages) -> None:
        available = min(len(messages[topic]) for topic in _STREAMS)
        self._take_commands(messages.get(COMMANDS, []))
        if available <= self._used:
            return
        blocks = [
            self._decoders[topic].decode_many(messages[topic][self._used : available])
            for topic in _STREAMS
        ]
        self._accumulator.push(blocks[0][1], blocks[1][1], blocks[2][1])
        for topic, (stamps, values) in zip(_STREAMS, blocks, strict=True):
            self._values[topic].append(values)
            self._stamps[topic].append(stamps)
        self._check_stamps([stamps for stamps, _ in blocks])
        self._used = available

    def _take_commands(self, messages: list[bytes]) -> None:
        commands = self._values[COMMANDS]
        try:
            if len(messages) > commands.count:
                commands.append(self._command_decoder.decode_many(messages[commands.count :]))
        except MalformedMessageError:
            return  # The column does without; a later one cannot take the place of this command.

    def _check_stamps(self, stamps: list[NDArray[np.int64]]) -> None:
        """Find out whether a sample is missing, doubled or out of order on any stream."""
        before = stamps[0][:1] - PERIOD_NS if self._last_ns is None else [self._last_ns]
        steps = np.diff(stamps[0], prepend=before)
        self._in_step &= all(np.array_equal(stamps[0], other) for other in stamps[1:])
        self._in_step &= bool((np.abs(steps - PERIOD_NS) < PERIOD_NS // 2).all())
        self._last_ns = int(stamps[0][-1])


class _Rows:
    """Rows of numbers that grow at their ends."""

    def __init__(self, rows: int) -> None:
        self._buffer = np.empty((rows, 1 << 14))
        self.count = 0

    def append(self, block: NDArray[np.float64]) -> None:
        end = self.count + block.shape[1]
        if end > self._buffer.shape[1]:
            larger = np.empty((self._buffer.shape[0], 2 * end))
            larger[:, : self.count] = self._buffer[:, : self.count]
            self._buffer = larger
        self._buffer[:, self.count : end] = block
        self.count = end

    def first(self, count: int) -> NDArray[np.float64]:
        return self._buffer[:, :count]
