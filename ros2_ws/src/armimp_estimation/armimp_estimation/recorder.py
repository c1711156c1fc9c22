"""Recording of live messages, estimates from a running trial, and its assembly at the end."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from armimp_common.arrays import IntArray
from armimp_common.cdr import encode_trial_status, stamp_of
from armimp_common.errors import ArmimpError, DataError, MalformedMessageError
from armimp_common.status import (
    NOTICE_TICKS,
    Phase,
    Progress,
    StoppingDecision,
    TrialStatus,
)
from armimp_common.topics import (
    COMMANDS,
    DATA_STREAMS,
    JOINT_STATES,
    PERIOD_NS,
    PERTURBATION,
    RATE,
    TORQUE_SENSORS,
    TRIAL,
    VALUE_FIELD,
)
from armimp_estimation.alignment.assemble import Trial, assemble_trials
from armimp_estimation.alignment.streams import Streams, stamps_in_step
from armimp_estimation.bags.reader import BAGS
from armimp_estimation.bags.writer import BagWriter, definitions, require_free_space
from armimp_estimation.estimators.lpm import FittedColumn, LpmFull
from armimp_estimation.metadata import RECORD_KEY, Metadata
from armimp_estimation.parameters import EstimatorParameters
from armimp_estimation.problems import Problem, ProblemCode
from armimp_estimation.record import TrialRecord
from armimp_estimation.scores import coherence
from armimp_estimation.trial import TrialData

_ROUND = 1000
"""A running record is cut to a multiple of this number of samples for an estimate."""
_SEEN_EVERY = 1.0
"""Least wall time between estimates from a running trial, and from its start to the first (s)."""
_SHARE = 30.0
"""Estimates from a running trial take at most about one part in `_SHARE` of the wall time."""
_ORDER = (JOINT_STATES, TORQUE_SENSORS, PERTURBATION, COMMANDS)
"""Streams in the order in which the messages of one tick are recorded."""
_KEPT_BETWEEN = 3000
"""Messages of each stream that are kept between trials, in case the status of the next trial is
late; queues hold fewer."""
_DRIFT, _MOST_DRIFT_NS = 2e-4, 250_000_000
"""How much the clock of a driver may lose: as a share of the planned time, and in total (ns)."""
_STEP_BACK_NS = 1_000_000_000
"""Stamps that step back by more than this (ns) belong to another run."""
_STRAY = 50
"""Number of messages whose median stamp is the present time, even if some are strays."""
_DECIDED_EVERY = 2.0
"""Least time between decisions on an early end (s)."""
_GROWTH = 10
"""Between decisions, a trial grows by at least one part in `_GROWTH` of its length, as estimates
from long records take long."""
_OVERDUE_NS = 2_000_000_000
"""Samples missing this long after the planned end (ns) are lost, as queues do not hold more."""


class TrialRecorder:
    """Records each trial into its own bag and hands it over when it is complete.

    A bag holds all messages from up to three seconds before the trial until its end.
    `assemble_trials` finds the samples of the trial among them, live and when the bag is read.

    Parameters
    ----------
    settings : EstimatorParameters
        Those of the node. Without a directory, nothing is recorded.
    on_finished : callable
        Called with each finished trial, or with the problem that prevented its assembly.
    refuse : callable, optional
        Called with topic and error for each message that is too short to have a stamp.

    Raises
    ------
    ConfigurationError, DataError
        If the metadata in the settings make no sense.
    """

    def __init__(
        self,
        settings: EstimatorParameters,
        on_finished: Callable[[Trial | Problem], None],
        refuse: Callable[[str, MalformedMessageError], None] = lambda *_: None,
    ) -> None:
        self._settings, self._on_finished, self._refuse = settings, on_finished, refuse
        self._metadata = settings.bag_metadata()
        self.known = Metadata.of(self._metadata, len(settings.joints))
        """What is known of the experiment. Its timing, the latest one of the run, is stored in the
        bag of each trial when that ends."""
        self._writer: BagWriter | None = None
        self._recording = settings.record and bool(settings.directory)
        if self._recording:
            definitions()  # no trial should wait for the first call
        self._bag = ""
        self._past: list[TrialRecord] = []
        self._between = {topic: deque[bytes](maxlen=_KEPT_BETWEEN) for topic in DATA_STREAMS}
        """Messages since the end of the last trial's perturbation."""
        self._later: deque[TrialStatus] = deque()
        """Statuses of trials after the present one."""
        self._announced: dict[int, int] = {}
        """Announced length of each trial (samples)."""
        self._enough: set[int] = set()
        """Trials that may end early."""
        self._forget()

    def _forget(self) -> None:
        self._statuses: list[TrialStatus] = []
        self._unwritten: list[TrialStatus] = []
        self._streams = Streams(self._settings.joints)
        self._start_ns: int | None = None
        self._before = dict.fromkeys(VALUE_FIELD, 0)
        """Messages of the present bag with stamps before the trial."""
        self._newest_ns = dict.fromkeys(VALUE_FIELD, -1)
        self._log_ns = dict.fromkeys(DATA_STREAMS, -1)
        self._began = self._look_at = 0.0
        self._rule: StoppingRule | None = None
        self._column: FittedColumn | None = None
        self._coherence: tuple[float, float] | None = None
        """Band means of γ²(τΔ, θ_k) and γ²(τΔ, τ_k)."""

    @property
    def status(self) -> TrialStatus | None:
        """Last status of the present trial; None between trials."""
        return self._statuses[-1] if self._statuses else None

    @property
    def samples(self) -> int:
        """Number of complete samples of the present trial so far."""
        if self._start_ns is None:
            return 0
        counts = [self._streams[topic].received - before for topic, before in self._before.items()]
        counts.append(self._streams[COMMANDS].received - self._before[PERTURBATION])
        return max(min(*counts, self._statuses[-1].ticks), 0)

    def contradiction(self, status: TrialStatus) -> str:
        """Say how a status contradicts the announced length of its trial; empty if it does not."""
        trial, ticks = status.trial, status.ticks
        announced = self._announced.setdefault(trial, ticks)
        if ticks > announced:
            return f"trial {trial} has {ticks} samples, not {announced} any more"
        # A node that does not record, as in a replay, can't know which trials may end early.
        if ticks < announced and self._settings.record and trial not in self._enough:
            early = f"ends after {ticks} samples, which nobody asked for, not {announced}"
            return f"trial {trial} {early}"
        self._announced[trial] = ticks
        return ""

    def add_status(self, status: TrialStatus) -> None:
        """Process a trial status; those of later trials wait until the present one is complete.

        Raises
        ------
        BagError
            If the bag of a new trial can't be written.
        """
        present = self.status
        if present is not None and status.trial != present.trial:
            self._later.append(status)
            if present.phase is Phase.PERTURB:  # its end was not recorded
                self.finish()
            return
        if present is None:
            if status.phase not in (Phase.SETTLE, Phase.PERTURB):
                return
            self._open(status)
        self._statuses.append(status)
        self._unwritten.append(status)
        if status.start_ns is not None and self._start_ns is None:
            self._begin(status, status.start_ns)
        self._write_statuses()
        if status.phase is Phase.ABORTED:
            self.finish()
        else:
            self._finish_if_complete()

    def add(self, messages: Mapping[str, Sequence[bytes]]) -> None:
        """Record messages of the data streams, usually those of many complete samples at once.

        Raises
        ------
        BagError
            If they can't be written.
        """
        self._take(messages)
        self._finish_if_complete()

    def add_beside(self, topic: str, message: bytes) -> None:
        """Record a message that is no sample, such as diagnostics, at the time of the last sample.

        Raises
        ------
        BagError
            If it can't be written.
        """
        if self._writer is not None and (time_ns := max(self._log_ns.values())) >= 0:
            self._writer.write(topic, message, time_ns)

    def progress(self) -> Progress | None:
        """Report how far the trial is and what its samples show so far; None between trials."""
        if (status := self.status) is None:
            return None
        if self._coherence is None or time.monotonic() >= self._look_at:
            self._look()
        motion, torque = self._coherence or (None, None)
        so_far: dict[str, Any] = {}
        if (column := self._column) is not None:
            for letter, found, errors in zip("MBK", column.values, column.errors, strict=True):
                so_far |= {letter: tuple(found.tolist()), f"{letter}_se": tuple(errors.tolist())}
            so_far["largest_error"] = largest_error(column)[0]
            so_far["preliminary"] = column.preliminary
        samples, elapsed = self.samples, time.monotonic() - self._began
        return Progress(
            trial=status.trial,
            trials=status.trials,
            joint=status.joint + 1,
            phase=status.phase,
            samples=samples,
            planned=status.ticks,
            rate=samples / elapsed if self._began else 0.0,
            coherence_motion=motion,
            coherence_torque=torque,
            **so_far,
        )

    def _look(self) -> None:
        """Update coherences, and the column if it is due, from the present trial so far."""
        record = record_so_far(self._streams, self._statuses, self.samples)
        if record is not None:
            with suppress(DataError):  # too few samples
                trial = TrialData.of(record)
                joint = trial.joint
                shown = trial.position_channel(joint), trial.torque_channel(joint)
                motion, torque = (coherence(trial.spectra, 0, one) for one in shown)
                self._coherence = float(np.mean(motion)), float(np.mean(torque))
        if (began := time.monotonic()) >= self._look_at:
            if record is not None:
                # Fourier transforms of other lengths may take several times as long.
                record = record.part(0, record.samples // _ROUND * _ROUND)
            self._fit(record)
            ended = time.monotonic()
            self._look_at = ended + max(_SEEN_EVERY, _SHARE * (ended - began))

    def decide(self) -> StoppingDecision | None:
        """Decide whether the present trial has lasted long enough, if a decision is due."""
        if self._rule is None or self._statuses[-1].phase is not Phase.PERTURB:
            return None
        decision = self._rule.decide(
            self.samples,
            lambda samples: self._fit(record_so_far(self._streams, self._statuses, samples)),
        )
        if decision is not None and decision.enough:
            self._enough.add(decision.trial)
        return decision

    def _fit(self, record: TrialRecord | None) -> FittedColumn | None:
        """Estimate column k from a record, and keep it for progress reports."""
        self._column = None
        if record is not None and record.samples:
            with suppress(DataError):  # too few samples
                record = replace(record, reading=self.known.reading)
                self._column = LpmFull().column(record, self._past)
        return self._column

    def stop(self) -> None:
        """Finish all trials that have begun, complete or not, and close the bag."""
        while self._statuses:
            self.finish()
        self.close()

    def close(self) -> None:
        """Close the bag of the present trial, complete or not.

        Raises
        ------
        BagError
            If the bag can't be finished; it remains readable.
        """
        if self._writer is not None:
            writer, self._writer = self._writer, None
            writer.close()

    def _open(self, status: TrialStatus) -> None:
        self.close()
        if self._recording:
            self._bag = f"{BAGS}/trial_{status.trial}_joint_{status.joint + 1}"
            path = Path(self._settings.directory, self._bag)
            require_free_space(path, _KEPT_BETWEEN + status.ticks, len(self._settings.joints))
            self._writer = BagWriter(path, metadata=self._metadata)

    def _begin(self, status: TrialStatus, start_ns: int) -> None:
        """Begin with the samples of a trial, and record the messages kept from before it."""
        self._start_ns, self._began = start_ns, time.monotonic()
        self._look_at = self._began + _SEEN_EVERY
        if self._settings.target_error:
            self._rule = StoppingRule(self._settings, status)
        stamps = np.array([_stamp(message) for message in self._between[PERTURBATION]])
        first = _last_step_back(stamps, start_ns)
        waiting = {topic: list(raws)[first:] for topic, raws in self._between.items()}
        for raws in self._between.values():
            raws.clear()
        latest_ns = start_ns + status.ticks * PERIOD_NS + _STEP_BACK_NS
        # Messages of a later time, as when bags are replayed in any order, are not recorded.
        if not stamps.size or np.median(stamps[-_STRAY:]) <= latest_ns:
            self._take(waiting)

    def _take(self, messages: Mapping[str, Sequence[bytes]]) -> None:
        """Decode and write messages of the present bag, as one block if streams are in step."""
        if self._start_ns is None:
            for topic, raws in messages.items():
                self._between[topic].extend(raws)
            return
        stamps = stamps_in_step(messages, self._newest_ns[PERTURBATION])
        if stamps and stamps[-1] < self._end_ns:
            self._write_statuses(stamps[0])
            self._count(VALUE_FIELD, stamps)
            self._log_ns = dict.fromkeys(DATA_STREAMS, stamps[-1])
            for topic in _ORDER:
                self._streams[topic].add(messages[topic])
            if self._writer is not None:
                self._writer.write_block(stamps, {topic: messages[topic] for topic in _ORDER})
            return
        for tick in range(max(map(len, messages.values()), default=0)):
            for topic in _ORDER:
                if tick < len(raws := messages.get(topic, ())):
                    self._take_one(topic, raws[tick])
        if self._writer is not None:
            self._writer.flush()  # a block of samples is flushed by the writer itself

    def _take_one(self, topic: str, message: bytes) -> None:
        past = self._is_past(PERTURBATION)
        if topic == COMMANDS:
            led_ns = self._newest_ns[PERTURBATION]
            stamp_ns = led_ns if led_ns >= 0 else max(*self._newest_ns.values(), 0)
            led, answered = self._streams[PERTURBATION], self._streams[COMMANDS]
            belongs = not past or answered.received < led.received
        else:
            try:
                stamp_ns = stamp_of(message)
            except MalformedMessageError as error:
                self._refuse(topic, error)
                return
            self._count((topic,), (stamp_ns,))
            belongs = not past or stamp_ns < self._end_ns
        if not belongs:  # it is of the next trial
            self._between[topic].append(message)
            return
        self._streams[topic].add((message,))
        # Readers sort by this time, so it must not decrease within a stream.
        self._log_ns[topic] = max(stamp_ns, self._log_ns[topic])
        self._write_statuses(self._log_ns[topic])
        if self._writer is not None:
            self._writer.write(topic, message, self._log_ns[topic])

    def _count(self, topics: Iterable[str], stamps: Sequence[int]) -> None:
        for topic in topics:
            self._newest_ns[topic] = stamps[-1]
            if self._start_ns is not None and stamps[0] < self._start_ns:
                self._before[topic] += sum(stamp_ns < self._start_ns for stamp_ns in stamps)

    def _write_statuses(self, time_ns: int | None = None) -> None:
        """Write new statuses; they have no stamp and get that of the latest sample, if any."""
        time_ns = max(self._log_ns.values()) if time_ns is None else time_ns
        if time_ns < 0:
            return
        new, self._unwritten = self._unwritten, []
        if self._writer is not None:
            for status in new:
                self._writer.write(TRIAL, encode_trial_status(status), time_ns)

    def _is_past(self, *topics: str, beyond_ns: int = 0) -> bool:
        """Whether streams are `beyond_ns` beyond the end of the trial."""
        return all(self._newest_ns[topic] >= self._end_ns + beyond_ns for topic in topics)

    @property
    def _end_ns(self) -> int:
        """Stamp from which on no sample belongs to the present trial (ns)."""
        planned = self._statuses[-1].ticks * PERIOD_NS
        return (self._start_ns or 0) + planned + min(int(planned * _DRIFT), _MOST_DRIFT_NS)

    def _finish_if_complete(self) -> None:
        status = self.status
        if status is None or status.phase not in (Phase.REST, Phase.DONE):
            return
        answered = self._streams[COMMANDS].received >= self._before[PERTURBATION] + status.ticks
        overdue = self._is_past(PERTURBATION, beyond_ns=_OVERDUE_NS)
        if overdue or (answered and self._is_past(*VALUE_FIELD)):
            self.finish()

    def finish(self) -> None:
        """Complete the present trial with the samples so far, if its perturbation has begun."""
        begun, statuses, streams = self._start_ns is not None, self._statuses, self._streams
        elapsed = time.monotonic() - self._began
        self._forget()
        if begun:
            self._on_finished(self._completed(statuses, streams, elapsed))
        later, self._later = self._later, deque()
        for status in later:
            self.add_status(status)

    def _completed(
        self, statuses: Sequence[TrialStatus], streams: Streams, elapsed: float
    ) -> Trial | Problem:
        """Assemble a trial that took `elapsed` seconds of wall time, and close its bag."""
        try:
            try:
                trials = assemble_trials(streams, statuses)
                if len(trials) != 1:
                    number = statuses[0].trial
                    raise DataError(f"trial {number}: its statuses announce {len(trials)} trials")
                if self._writer is not None and (timing := self.known.timing) is not None:
                    self._writer.add_metadata({RECORD_KEY: timing.model_dump_json()})
            finally:
                self.close()
        except ArmimpError as error:
            return Problem.of(error, ProblemCode.RECORDING_FAILED)
        (trial,) = trials
        if trial.record is not None:
            self._past.append(replace(trial.record, reading=self.known.reading))
        rtf = trial.statistics.span / RATE / elapsed
        allow_gaps = self._settings.allow_gaps
        return replace(trial, bag=self._bag or None, rtf=rtf, allow_gaps=allow_gaps)


def record_so_far(
    streams: Streams, statuses: Sequence[TrialStatus], samples: int
) -> TrialRecord | None:
    """Return the first `samples` samples of a running trial; None if any can't be used."""
    with suppress(DataError):
        for trial in assemble_trials(streams, statuses):
            begun = [one for one in trial.segments if one.start_ns == trial.window.start_ns]
            if begun and 0 < samples <= begun[0].samples:
                return begun[0].part(0, samples)
    return None


class StoppingRule:
    """Decides whether one trial may end, at sample counts that depend on its parameters only.

    Parameters
    ----------
    settings : EstimatorParameters
        The trial has lasted long enough if all relative standard errors (one standard error) of M,
        B and K of its column are below `target_error`, but never before `least_duration`.
    status : TrialStatus
        One with the planned number of samples, which the trial never exceeds.
    rate : float
        Samples per second, Hz.
    """

    def __init__(
        self, settings: EstimatorParameters, status: TrialStatus, rate: float = RATE
    ) -> None:
        self._bound = settings.target_error
        self._trial, self._planned = status.trial, status.ticks
        self._first = max(round(settings.least_duration * rate) - NOTICE_TICKS, 1)
        self._every = round(_DECIDED_EVERY * rate)
        self._due: int | None = 0

    def decide(
        self, samples: int, column: Callable[[int], FittedColumn | None]
    ) -> StoppingDecision | None:
        """Decide whether the trial has lasted long enough, if a decision is due.

        Parameters
        ----------
        samples : int
            Number of samples so far.
        column : callable
            Estimates the column from a number of first samples; None if that is impossible.

        Returns
        -------
        StoppingDecision or None
            None if no decision is due. The first decision only announces when the next is due.
        """
        if self._due is None or samples < self._due:
            return None
        considered, self._due = self._due, None
        found = column(considered) if considered else None
        largest, element = (np.nan, "") if found is None else largest_error(found)
        enough = bool(largest < self._bound)
        if not enough:
            later = considered + max(self._every, considered // _GROWTH)
            due = later if considered else self._first
            # Any later, the trial could no longer end before its planned end.
            self._due = due if due + NOTICE_TICKS < self._planned else None
        return StoppingDecision(
            trial=self._trial,
            samples=considered,
            enough=enough,
            due=self._due,
            bound=self._bound,
            largest=largest,
            element=element,
        )


def largest_error(column: FittedColumn) -> tuple[float, str]:
    """Largest relative standard error of a column, and the name of its element, such as ``K21``.

    It is one standard error over the absolute value of the parameter; infinite if that is 0.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = column.errors / np.abs(column.values)
    relative[np.isnan(relative)] = np.inf
    letter, row = np.unravel_index(int(relative.argmax()), relative.shape)
    return float(relative.max()), f"{'MBK'[letter]}{row + 1}{column.joint + 1}"


def _last_step_back(stamps: IntArray, start_ns: int) -> int:
    """Index of the first message after stamps stepped back to a trial's time; 0 if they did not.

    A few stray messages among the others are not a step: they are kept, so that they get reported.
    """
    for first in reversed(np.flatnonzero(np.diff(stamps) < -_STEP_BACK_NS) + 1):
        if np.median(stamps[max(first - _STRAY, 0) : first]) > start_ns + _STEP_BACK_NS:
            return int(first)
    return 0


def _stamp(message: bytes) -> int:
    """Stamp of a message (ns); -1 if it is too short to have one."""
    try:
        return stamp_of(message)
    except MalformedMessageError:
        return -1
