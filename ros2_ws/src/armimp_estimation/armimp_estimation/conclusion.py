"""From assembled trials to the result that is shown and stored; live and offline use this path."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from armimp_common.errors import ArmimpError, ConfigurationError, DataError
from armimp_common.topics import NS_PER_S, PERIOD_NS, PERTURBATION
from armimp_estimation.alignment.assemble import AssembledTrial
from armimp_estimation.alignment.gaps import GapConfig, judge_gaps, segments_for
from armimp_estimation.arm_models import AUTO, require_model
from armimp_estimation.estimators.estimate import Estimator
from armimp_estimation.estimators.lpm import LpmConfig
from armimp_estimation.fit import Calibration
from armimp_estimation.identify import Identification, identify
from armimp_estimation.mbk import MBK
from armimp_estimation.problems import Problem, ProblemCode
from armimp_estimation.realtime_timing import RECORD_KEY, TimingRecord
from armimp_estimation.results import (
    FindingSummary,
    Summary,
    TrialLedger,
    TrialSummary,
    TruthSummary,
    summarise,
    write_frf,
    write_summary,
)
from armimp_estimation.sampling import TOLERANCE
from armimp_estimation.settings import IdentifyConfig
from armimp_estimation.torque_timing import ReadingSummary, TorqueReading, TorqueTiming
from armimp_estimation.trial import TrialData

SUMMARY_FILE = "summary.json"
FRF_FILE = "frf.npz"
TIMING_KEY = "torque_timing"
"""Name in the metadata of bags of when torques are read, see :class:`TorqueTiming`."""
UNCERTAINTY_KEY = "torque_uncertainty"
"""Name there of the standard error of what is told of the instant of torque readings, s."""
MODEL_KEY = "arm_model"
"""Name there of the model of the arm that was asked for."""
CALIBRATION_KEYS = {"gain_uncertainty": "gain", "cross_talk_uncertainty": "cross_talk"}
"""Names there of what is declared of the transducers, by attribute of :class:`Calibration`."""
RATE_KEY = "sampling_rate"
"""Name there of the sampling rate, Hz, where it is an uncustomary one."""
READING_KEYS = {
    "torque_delay": "delay",
    "torque_cutoff": "cutoff",
    "torque_order": "order",
    "actuator_lag": "actuator_lag",
}
"""Names there of what else is known of the readings, by attribute of :class:`TorqueReading`."""

_LARGEST_TRUTH = 1e12
"""Far beyond any arm, far from where squares and products would overflow; SI units."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FinishedTrial:
    """A trial as it came out of the recorder or of a bag.

    Parameters
    ----------
    assembled : AssembledTrial
        Samples and their ledger.
    bag : str or None
        Where it is stored.
    rtf : float
        Times real time at which it ran; NaN if it was not run live.
    """

    assembled: AssembledTrial
    bag: str | None
    rtf: float = math.nan


@dataclass(frozen=True, kw_only=True, eq=False)
class Conclusion:
    """Result of an experiment.

    Attributes
    ----------
    summary : Summary
        Content of ``summary.json``; says whether the result is valid, and why not.
    identification : Identification or None
        Curves and scores; None if nothing could be estimated.
    """

    summary: Summary
    identification: Identification | None

    def write(self, directory: Path) -> None:
        """Write ``summary.json`` and, if there are curves, ``frf.npz``.

        Raises
        ------
        DataError
            If a file exists already or cannot be written.
        """
        if self.identification is not None:
            write_frf(directory / FRF_FILE, self.identification.estimators)
        write_summary(directory / SUMMARY_FILE, self.summary)


def conclude(
    trials: Sequence[FinishedTrial],
    *,
    metadata: Mapping[str, str],
    joint_names: Sequence[str],
    estimators: Sequence[str | Estimator],
    config: IdentifyConfig | None = None,
    gaps: GapConfig | None = None,
    problems: Sequence[str] = (),
) -> Conclusion:
    """Identify the impedance from the trials; what stands against it becomes a problem.

    Parameters
    ----------
    trials : sequence of FinishedTrial
        One for each joint.
    metadata : mapping of str to str
        That of the bags: configuration, seed, from a simulator the truth, and the timing of a run
        in real time.
    joint_names : sequence of str
        Names of the n joints.
    estimators : sequence of str or Estimator
        As for :func:`armimp_estimation.identify.identify`.
    config : IdentifyConfig, optional
        Options; by default Welch segments that suit the shortest trial, and torques read when the
        metadata say.
    gaps : GapConfig, optional
        What to do with trials that lost samples; by default they are refused.
    problems : sequence of str
        What is known to have gone wrong beforehand.

    Raises
    ------
    ConfigurationError
        If an estimator does not exist.
    DataError
        If the metadata make no sense.
    """
    found = list(problems)
    options = gaps if gaps is not None else GapConfig()
    identification = None
    joints = len(joint_names)
    told = understand(metadata, joints)
    truth, seed = told.truth, told.seed
    found += [] if told.timing is None else told.timing.problems
    if seed is None and trials:
        seed = trials[0].assembled.window.seed
    try:
        parts = [trial.assembled.intact(allow_gaps=options.allow) for trial in trials]
        reading = reading_of(metadata) if config is None else config.lpm.reading
        if config is None:
            lpm = LpmConfig(reading=reading, timing_uncertainty=uncertainty_of(metadata))
            config = IdentifyConfig(
                welch=segments_for(parts),
                lpm=lpm,
                model=model_of(metadata),
                calibration=calibration_of(metadata),
            )
        data = [TrialData.from_stretches(stretches, config.welch, reading) for stretches in parts]
        identification = identify(data, estimators, truth, config)
        found += [problem for one in trials for problem in judge_gaps(one.assembled, options)]
    except DataError as error:
        found.append(str(error))
    findings = [
        finding
        for one in trials
        for finding in one.assembled.findings
        if not _rate_is_declared(finding, metadata)
    ]
    findings += [] if identification is None else identification.problems
    if identification is None:
        return Conclusion(
            summary=Summary(
                config=told.config,
                joints=joints,
                joint_names=list(joint_names),
                seed=seed,
                valid=False,
                problems=found,
                findings=[FindingSummary.of(one) for one in findings],
                trials=[_bare(trial, joints) for trial in trials],
                estimators={},
                truth=None if truth is None else TruthSummary.of(truth),
                timing=None if told.timing is None else told.timing.summary,
            ),
            identification=None,
        )
    ledgers = {trial.assembled.segments[0].perturbed_joint: _ledger(trial) for trial in trials}
    summary = summarise(
        identification,
        ledgers,
        config=told.config,
        seed=seed,
        problems=tuple(found),
        findings=findings,
        timing=None if told.timing is None else told.timing.summary,
    )
    told_of_torques = {"torque_reading": ReadingSummary.of(reading)}
    summary = summary.model_copy(update=told_of_torques)
    return Conclusion(summary=summary, identification=identification)


@dataclass(frozen=True, kw_only=True, eq=False)
class Told:
    """What the metadata of a bag tell of its experiment.

    Attributes
    ----------
    config : dict
        Configuration; empty if they do not know it.
    truth : MBK or None
        True matrices, as far as there are any.
    seed : int or None
        Of all random signals.
    timing : TimingRecord or None
        Of a run in real time.
    """

    config: dict[str, Any]
    truth: MBK | None
    seed: int | None
    timing: TimingRecord | None = None


def understand(metadata: Mapping[str, str], joints: int) -> Told:
    """Read what the metadata of a bag tell of its experiment.

    Parameters
    ----------
    metadata : mapping of str to str
        May be empty.
    joints : int
        Number of joints n of the data.

    Raises
    ------
    DataError
        If something is there, but makes no sense.
    """
    config = _parsed(metadata, "config", {})
    if not isinstance(config, dict):
        raise DataError(f"metadata: config is not a JSON object: {metadata['config'][:60]!r}")
    truth = truth_of(metadata)
    if truth is not None and truth.joints != joints:
        raise DataError(f"metadata: truth is of {truth.joints} joints, the data of {joints}")
    seed = _parsed(metadata, "seed", None)
    whole = isinstance(seed, int) and not isinstance(seed, bool)
    timing = TimingRecord.from_json(metadata[RECORD_KEY]) if RECORD_KEY in metadata else None
    return Told(config=config, truth=truth, seed=seed if whole else None, timing=timing)


def truth_of(metadata: Mapping[str, str]) -> MBK | None:
    """True matrices from the metadata of a bag; None if it does not know them.

    Raises
    ------
    DataError
        If they are there, but make no sense.
    """
    truth = _parsed(metadata, "truth", None)
    if truth is None:
        return None
    try:
        found = MBK(**{name: np.array(truth[name], dtype=np.float64) for name in ("M", "B", "K")})
    except (LookupError, TypeError, ValueError, OverflowError, ArmimpError) as error:
        raise DataError(f"metadata: truth is not three matrices M, B, K: {error}") from None
    largest = max(float(np.max(np.abs(matrix))) for matrix in (found.M, found.B, found.K))
    if not largest < _LARGEST_TRUTH:
        raise DataError(f"metadata: truth has an element of {largest:g}, which no arm has")
    return found


def reading_of(metadata: Mapping[str, str]) -> TorqueReading:
    """How torques were read, from the metadata of a bag; ``unknown`` if it does not know.

    Raises
    ------
    DataError
        If something is there, but makes no sense.
    """
    known = [timing.value for timing in TorqueTiming]
    timing = _parsed(metadata, TIMING_KEY, TorqueTiming.UNKNOWN.value)
    if timing not in known:
        raise DataError(f"metadata: {TIMING_KEY} is {timing!r}, known are {', '.join(known)}")
    told = {}
    for key, name in READING_KEYS.items():
        value = _parsed(metadata, key, None)
        if value is None:
            continue
        whole = name == "order"
        if isinstance(value, bool) or not isinstance(value, int if whole else int | float):
            raise DataError(
                f"metadata: {key} is not {'an integer' if whole else 'a number'}: {value!r}"
            )
        told[name] = value
    try:
        return TorqueReading(timing=TorqueTiming(timing), **told)
    except ConfigurationError as error:
        raise DataError(f"metadata: {error}") from None


def uncertainty_of(metadata: Mapping[str, str]) -> float:
    """Standard error of what the metadata of a bag tell of the instant of torque readings, s.

    Raises
    ------
    DataError
        If it is there, but makes no sense.
    """
    value = _parsed(metadata, UNCERTAINTY_KEY, LpmConfig.timing_uncertainty)
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= 1.0:
        raise DataError(f"metadata: {UNCERTAINTY_KEY} is not a time in s: {value!r}")
    return float(value)


def model_of(metadata: Mapping[str, str]) -> str:
    """Model of the arm that the metadata of a bag ask for; ``auto`` if they don't.

    Raises
    ------
    DataError
        If there is none of that name.
    """
    try:
        return require_model(_parsed(metadata, MODEL_KEY, AUTO))
    except ConfigurationError as error:
        raise DataError(f"metadata: {error}") from None


def calibration_of(metadata: Mapping[str, str]) -> Calibration:
    """What the metadata of a bag declare of the transducers, else what is assumed of any.

    Raises
    ------
    DataError
        If something is there, but makes no sense.
    """
    told = {
        name: _parsed(metadata, key, None)
        for key, name in CALIBRATION_KEYS.items()
        if key in metadata
    }
    if not told:
        return Calibration.undeclared()
    if any(isinstance(one, bool) or not isinstance(one, int | float) for one in told.values()):
        raise DataError(f"metadata: uncertainty of the calibration is not a number: {told!r}")
    try:
        return replace(Calibration.undeclared(), assumed=len(told) < len(CALIBRATION_KEYS), **told)
    except ConfigurationError as error:
        raise DataError(f"metadata: {error}") from None


def _rate_is_declared(finding: Problem, metadata: Mapping[str, str]) -> bool:
    """Whether a problem is a sampling rate that the metadata declare as right."""
    declared = _parsed(metadata, RATE_KEY, None)
    if finding.code is not ProblemCode.RATE_UNCUSTOMARY or not isinstance(declared, int | float):
        return False
    rate = finding.values["rate"]
    return isinstance(rate, float) and abs(rate / declared - 1.0) <= TOLERANCE


def _parsed(metadata: Mapping[str, str], key: str, default: Any) -> Any:
    if key not in metadata:
        return default
    try:
        value = json.loads(metadata[key])
        # Half a surrogate pair can be read, but not be written again.
        json.dumps(value, ensure_ascii=False).encode()
    except (ValueError, RecursionError):
        raise DataError(f"metadata: {key} is not JSON: {metadata[key][:60]!r}") from None
    return value


def _ledger(trial: FinishedTrial) -> TrialLedger:
    ledger = trial.assembled.ledger
    return TrialLedger(
        bag=trial.bag,
        ticks=ledger.streams[PERTURBATION].received,
        lost=ledger.lost,
        rtf=trial.rtf,
        saved=trial.assembled.window.saved * PERIOD_NS / NS_PER_S,
        samples=ledger,
    )


def _bare(trial: FinishedTrial, joints: int) -> TrialSummary:
    """A trial without scores, as nothing could be estimated."""
    nothing = [math.nan] * joints
    return TrialSummary.of(
        _ledger(trial), trial.assembled.window.joint, lock_ratio=nothing, bias_bound=nothing
    )
