"""From live messages to trials: segmenting, recording, assembling, and figures meanwhile."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from armimp_common.errors import ArmimpError, DataError
from armimp_common.status import Phase, Progress, StoppingDecision, TrialStatus
from armimp_common.topics import (
    JOINT_STATES,
    NS_PER_S,
    PERIOD_NS,
    PERTURBATION,
    TORQUE_SENSORS,
    TRIAL,
)
from armimp_estimation.alignment.assemble import Trial, assemble_trials
from armimp_estimation.alignment.streams import Streams
from armimp_estimation.alignment.trial_segmenter import TrialSegmenter
from armimp_estimation.bags import BagWriter, expected_bytes, require_free_space
from armimp_estimation.bags.files import BAGS
from armimp_estimation.bags.statuses import encode_trial_status
from armimp_estimation.estimators.lpm import FittedColumn, LpmConfig, LpmFull
from armimp_estimation.metadata import RECORD_KEY, Timing
from armimp_estimation.problems import Problem, ProblemCode
from armimp_estimation.record import TrialRecord
from armimp_estimation.scores import coherence
from armimp_estimation.spectra import SpectralAccumulator, WelchConfig
from armimp_estimation.stopping import PrecisionGoal, StoppingRule, largest_error
from armimp_estimation.trial import TrialSpectra, channels

_RATE = NS_PER_S / PERIOD_NS
_ROUND = 1000
_COLUMN_PERIOD = 1.0
"""Wall time between two estimates of the running column (s); each takes some 20 ms."""


class TrialRecorder:
    """Records each trial into its own bag and hands it over when it is complete.

    Parameters
    ----------
    joint_names : tuple of str
        Names of the n joints.
    directory : Path or None
        Where ``bags/`` is made; None records nothing.
    metadata : mapping of str to str
        Stored in every bag.
    on_finished : callable
        Called with each trial, or with the reason why none could be made.
    lpm : LpmConfig, optional
        Options of the running column.
    goal : PrecisionGoal, optional
        When trials may end before their time; by default never.
    """

    def __init__(
        self,
        joint_names: tuple[str, ...],
        directory: Path | None,
        metadata: Mapping[str, str],
        on_finished: Callable[[Trial | Problem], None],
        *,
        lpm: LpmConfig | None = None,
        goal: PrecisionGoal | None = None,
    ) -> None:
        self._joint_names = joint_names
        self._directory, self._metadata = directory, metadata
        self._on_finished = on_finished
        self._segmenter = TrialSegmenter(joint_names, self._write, self._on_complete, self._open)
        self._writer: BagWriter | None = None
        self._bag = ""
        self._lpm = LpmFull() if lpm is None else LpmFull(config=lpm)
        self._goal = goal if goal is not None else PrecisionGoal()
        self._running: RunningTrial | None = None
        self._rule: StoppingRule | None = None
        self._column: FittedColumn | None = None
        self._column_at = 0.0
        self._past: list[TrialRecord] = []
        self._began = self._opened_at = self._perturbed_at = 0.0
        self._last_ns = 0
        self._statuses_written = 0
        self._seen = 0
        self._latest_ns: dict[str, int] = {}
        self.timing: Timing | None = None
        """Latest known timing of the run, which goes into the bag of each trial as it ends."""
        self.add, self.add_many = self._segmenter.add, self._segmenter.add_many

    @property
    def status(self) -> TrialStatus | None:
        """Last status of the present trial; None between trials."""
        return self._segmenter.status

    @property
    def samples(self) -> int:
        """Number of complete samples of the present trial so far."""
        return self._segmenter.samples

    @property
    def rate(self) -> float:
        """Samples per second of wall time in the present trial, Hz."""
        return self.samples / (time.monotonic() - self._began) if self._began else 0.0

    def add_status(self, status: TrialStatus) -> None:
        """Take a trial status.

        Raises
        ------
        BagError
            If the bag of a new trial can't be written.
        """
        if status.phase is Phase.PERTURB:
            self._perturbed_at = time.monotonic()
        self._segmenter.add_status(status)

    def add_beside(self, topic: str, message: bytes, time_ns: int | None = None) -> None:
        """Record a message that is no sample, such as diagnostics, beside the last sample.

        Parameters
        ----------
        topic : str
        message : bytes
        time_ns : int, optional
            Stamp of the last sample (ns), if that was not added yet.

        Raises
        ------
        BagError
            If it can't be written.
        """
        if self._writer is not None and self._statuses_written:
            self._writer.write(topic, message, max(self._last_ns, time_ns or 0))

    def progress(self) -> Progress | None:
        """Where the recording stands, with what the samples tell so far; None between trials."""
        if (status := self.status) is None:
            return None
        motion, torque = self.coherence() or (None, None)
        so_far: dict[str, Any] = {}
        if (column := self.column()) is not None:
            for letter, found, errors in zip("MBK", column.values, column.errors, strict=True):
                so_far |= {letter: tuple(found.tolist()), f"{letter}_se": tuple(errors.tolist())}
            so_far["largest_error"] = largest_error(column)[0]
            so_far["preliminary"] = column.preliminary
        return Progress(
            trial=status.trial,
            trials=status.trials,
            joint=status.joint + 1,
            phase=status.phase,
            samples=self.samples,
            planned=status.ticks,
            rate=self.rate,
            coherence_motion=motion,
            coherence_torque=torque,
            **so_far,
        )

    def coherence(self) -> tuple[float, float] | None:
        """Running coherence (motion, torque) of the present trial, see `RunningTrial`."""
        running = self._present()
        return None if running is None else running.coherence()

    def column(self) -> FittedColumn | None:
        """Column k as the present trial gives it so far, made anew at most once a second."""
        if time.monotonic() - self._column_at >= _COLUMN_PERIOD:
            # Round numbers: the Fourier transform of others may take several times as long.
            self._column_of(self.samples // _ROUND * _ROUND)
        return self._column

    def decide(self) -> StoppingDecision | None:
        """Decide whether the present trial has lasted long enough, if it is time."""
        status = self.status
        if not self._goal.bound or status is None or status.phase is not Phase.PERTURB:
            return None
        if self._rule is None:
            self._rule = StoppingRule(
                self._goal, trial=status.trial, planned=status.ticks, rate=_RATE
            )
        return self._rule.decide(self.samples, self._column_of)

    def _column_of(self, samples: int) -> FittedColumn | None:
        running = self._present()
        if running is not None:
            self._column = running.column(samples)
            if self._column is not None:
                # From its end on, so that a slow machine does not do nothing else.
                self._column_at = time.monotonic()
        return self._column

    def _present(self) -> RunningTrial | None:
        status = self.status
        if status is not None and self._running is None:
            self._running = RunningTrial(
                self._segmenter.streams,
                status.joint,
                rate=_RATE,
                planned=status.ticks,
                trial=status.trial,
                lpm=self._lpm,
                others=self._past,
            )
        return self._running

    def stop(self) -> None:
        """Finish all trials that have begun with what there is, and close the bag."""
        while self.status is not None:
            self._segmenter.finish()
        self.close()

    def close(self) -> None:
        """Close the bag of the present trial, complete or not.

        Raises
        ------
        BagError
            If the bag can't be finished; it stays readable.
        """
        if self._writer is not None:
            writer, self._writer = self._writer, None
            writer.close()

    def flush(self, *, if_idle: bool = False) -> None:
        """Hand what was recorded to the operating system, where a kill cannot reach it.

        Parameters
        ----------
        if_idle : bool
            Only if nothing has come since the last such call.

        Raises
        ------
        BagError
            If that fails.
        """
        if self._writer is not None and not (if_idle and self.samples != self._seen):
            self._writer.flush()
        self._seen = self.samples

    def _open(self, status: TrialStatus) -> None:
        self.close()
        self._running = self._rule = self._column = None
        self._began = self._column_at = 0.0
        self._opened_at = time.monotonic()
        self._statuses_written = 0
        self._latest_ns.clear()
        if self._directory is not None:
            self._bag = f"{BAGS}/trial_{status.trial}_joint_{status.joint + 1}"
            path = self._directory / self._bag
            require_free_space(path, expected_bytes(status.ticks, len(self._joint_names)))
            self._writer = BagWriter(path, metadata=self._metadata)

    def _write(self, stamps: Sequence[int], messages: Mapping[str, Sequence[bytes]]) -> None:
        if self._statuses_written == 0:
            # The messages may have waited for others, with which they are written.
            self._began = max(self._perturbed_at, self._opened_at)
            self._write_statuses(self._segmenter.statuses, stamps[0])
        self._last_ns = stamps[-1]
        if self._writer is None:
            return
        if len(stamps) > 1:
            # Each stream goes on after what was written of it: stamps of ticks in step are later.
            self._latest_ns.update(dict.fromkeys(messages, stamps[-1]))
            self._writer.write_block(stamps, messages)
            return
        for topic, (message,) in messages.items():
            # Readers sort by this time, and shall find every stream in the order of its arrival.
            log_time_ns = max(stamps[0], self._latest_ns.get(topic, 0))
            self._latest_ns[topic] = log_time_ns
            self._writer.write(topic, message, log_time_ns)

    def _write_statuses(self, statuses: Sequence[TrialStatus], time_ns: int) -> None:
        """Statuses have no stamp: they get that of the sample beside them."""
        new = statuses[self._statuses_written :]
        self._statuses_written = len(statuses)
        if self._writer is not None:
            for status in new:
                self._writer.write(TRIAL, encode_trial_status(status), time_ns)

    def _on_complete(self, statuses: Sequence[TrialStatus], streams: Streams) -> None:
        elapsed = time.monotonic() - self._began
        try:
            try:
                if self._statuses_written:
                    self._write_statuses(statuses, self._last_ns)
                trial = self._assemble(statuses, streams)
                if self._writer is not None and self.timing is not None:
                    self._writer.add_metadata({RECORD_KEY: self.timing.model_dump_json()})
            finally:
                self.close()
        except ArmimpError as error:
            self._on_finished(Problem.of(error, ProblemCode.RECORDING_FAILED))
            return
        duration = trial.statistics.span / _RATE
        self._on_finished(replace(trial, bag=self._bag or None, rtf=duration / elapsed))

    def _assemble(self, statuses: Sequence[TrialStatus], streams: Streams) -> Trial:
        trials = assemble_trials(streams, statuses)
        if len(trials) != 1:
            number = statuses[0].trial
            raise DataError(f"trial {number}: its statuses speak of {len(trials)} trials")
        if trials[0].record is not None:
            self._past.append(trials[0].record)
        return trials[0]


class RunningTrial:
    """What the samples recorded so far tell, for people who watch and to know when it is enough.

    Parameters
    ----------
    streams : Streams
        Those of the trial, which grow.
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
        streams: Streams,
        joint: int,
        *,
        rate: float,
        planned: int,
        trial: int = 1,
        lpm: LpmFull | None = None,
        others: Sequence[TrialRecord] = (),
    ) -> None:
        self._streams, self._others = streams, others
        self._joint, self._rate, self._trial = joint, rate, trial
        self._lpm = lpm if lpm is not None else LpmFull()
        self._accumulator = SpectralAccumulator(
            2 * len(streams.joint_names) + 1, rate, WelchConfig.for_samples(planned)
        )
        self._used = 0
        self._in_step = True

    def coherence(self) -> tuple[float, float] | None:
        """Band means of γ²(τΔ, θ_k) and γ²(τΔ, τ_k).

        Returns
        -------
        (motion, torque) or None
            None until there are two segments, and after a sample that cannot be used (which the
            final account will name).
        """
        try:
            self._take()
            if self._accumulator.segments < 2:
                return None
            spectra = self._accumulator.result()
        except DataError:
            return None
        trial = TrialSpectra(perturbed_joint=self._joint, spectra=spectra)
        shown = trial.position_channel(self._joint), trial.torque_channel(self._joint)
        motion, torque = (float(np.mean(coherence(spectra, 0, one))) for one in shown)
        return motion, torque

    def column(self, samples: int | None = None) -> FittedColumn | None:
        """Column k of M, B and K with standard errors, as :meth:`LpmFull.column` gives it.

        Parameters
        ----------
        samples : int, optional
            How many samples to use, from the first on; by default all that are there.

        Returns
        -------
        FittedColumn or None
            None where the samples are too few, or one is missing or cannot be used.
        """
        try:
            self._take()
            count = self._used if samples is None else samples
            if not self._in_step or not 0 < count <= self._used:
                return None
            streams, commands = self._streams, self._streams.commands
            known = commands.count >= count and not commands.defect
            return self._lpm.column(
                TrialRecord(
                    trial=self._trial,
                    perturbed_joint=self._joint,
                    rate=self._rate,
                    joint_names=streams.joint_names,
                    perturbation=streams.stamped[PERTURBATION].values[:, :count],
                    position=streams.stamped[JOINT_STATES].values[:, :count],
                    torque=streams.stamped[TORQUE_SENSORS].values[:, :count],
                    start_ns=0,
                    seed=None,
                    command=commands.values[:, :count] if known else None,
                ),
                self._others,
            )
        except DataError:
            return None

    def _take(self) -> None:
        """Take in what has come since the last call."""
        stamped = self._streams.decode().stamped
        streams = [stamped[topic] for topic in (PERTURBATION, JOINT_STATES, TORQUE_SENSORS)]
        available = min(stream.count for stream in streams)
        new = slice(self._used, available)
        if any(stream.malformed for stream in streams):
            raise DataError("a message cannot be decoded")
        if available <= self._used:
            return
        new_values = (stream.values[:, new] for stream in streams)
        self._accumulator.push(channels(self._joint, *new_values))
        # Whether a sample is missing, doubled or out of order on any stream.
        first, *others = (stream.stamps for stream in streams)
        steps = np.diff(first[max(self._used - 1, 0) : available])
        self._in_step &= all(np.array_equal(first[new], other[new]) for other in others)
        self._in_step &= bool((np.abs(steps - PERIOD_NS) < PERIOD_NS // 2).all())
        self._used = available
