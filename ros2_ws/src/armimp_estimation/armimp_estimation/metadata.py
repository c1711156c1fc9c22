"""What the metadata of a recording tell of its experiment, its timing in real time among it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from pydantic import ValidationError, model_validator
from typing_extensions import Self

from armimp_common.errors import ArmimpError, ConfigurationError, DataError
from armimp_common.realtime import LATE_NS, TimingLimits
from armimp_common.status import TimingFigures
from armimp_estimation.arm_models import AUTO, require_model
from armimp_estimation.estimators.lpm import LpmConfig
from armimp_estimation.fit import Calibration
from armimp_estimation.json_model import JsonModel, Number, first_complaint
from armimp_estimation.mbk import MBK
from armimp_estimation.problems import Problem, ProblemCode, problem
from armimp_estimation.torque_timing import TorqueReading, TorqueTiming

TIMING_KEY = "torque_timing"
"""Name in the metadata of bags of when torques are read, see :class:`TorqueTiming`."""
UNCERTAINTY_KEY = "torque_uncertainty"
"""Name there of the standard error with which the instant of torque readings is known, s."""
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
RECORD_KEY = "timing"
"""Metadata of a bag: timing up to the end of its trial, as JSON."""


class Timing(JsonModel):
    """What was measured in real time, and what was allowed; durations in s."""

    ticks: int
    late: int
    missed: int
    period_p50: Number
    period_p99: Number
    period_max: Number
    latency_p50: Number
    latency_p99: Number
    latency_max: Number
    max_late_share: float
    max_missed_share: float
    max_latency: float

    @model_validator(mode="after")
    def _check_counts(self) -> Self:
        for name in ("late", "missed"):
            if not 0 <= getattr(self, name) <= self.ticks:
                raise ValueError(f"{name} must lie between 0 and {self.ticks} samples")
        return self

    @classmethod
    def of(cls, figures: TimingFigures, limits: TimingLimits) -> Timing:
        """Figures from the first sample of the run on, and limits of the run."""
        return cls(**asdict(figures), **asdict(limits))

    @property
    def problems(self) -> list[Problem]:
        """What is beyond its limit; comparisons are written so that NaN fails."""
        found = []
        for code, count, limit in (
            (ProblemCode.SAMPLES_LATE, self.late, self.max_late_share),
            (ProblemCode.COMMANDS_LATE, self.missed, self.max_missed_share),
        ):
            share = count / self.ticks if self.ticks else 0.0
            if not share <= limit:
                values = {"percent": 100.0 * share, "limit": 100.0 * limit}
                found.append(
                    problem(code, count=count, ticks=self.ticks, late_ms=LATE_NS / 1e6, **values)
                )
        if not self.latency_p99 <= self.max_latency:
            ms, limit = 1e3 * self.latency_p99, 1e3 * self.max_latency
            found.append(problem(ProblemCode.LATENCY, ms=ms, limit=limit))
        return found

    def begins(self, other: Timing) -> bool:
        """Whether this can be the beginning of the same run, which the other knows more of."""
        limits = ("max_late_share", "max_missed_share", "max_latency")
        return (
            all(getattr(self, name) == getattr(other, name) for name in limits)
            and self.ticks < other.ticks
            and self.late <= other.late
            and self.missed <= other.missed
            # Written so that what was not measured yet contradicts nothing.
            and not self.period_max > other.period_max
            and not self.latency_max > other.latency_max
        )

    @classmethod
    def from_metadata(cls, metadata: Mapping[str, str]) -> Timing | None:
        """That in the metadata of a bag; None if there is none.

        Raises
        ------
        DataError
            If it makes no sense.
        """
        if RECORD_KEY not in metadata:
            return None
        try:
            return cls.model_validate_json(metadata[RECORD_KEY])
        except ValidationError as error:
            raise DataError(f"metadata: {RECORD_KEY}: {first_complaint(error)}") from None


@dataclass(frozen=True, kw_only=True, eq=False)
class Metadata:
    """What is known of an experiment beside its samples.

    Attributes
    ----------
    config : dict
        Configuration; empty if it is not known.
    truth : MBK or None
        True matrices, as far as there are any.
    seed : int or None
        Of all random signals.
    timing : Timing or None
        Of a run in real time.
    reading : TorqueReading
        How torques were read; ``unknown`` if nobody says.
    uncertainty : float
        Standard error with which the instant of torque readings is known, s.
    rate : float or None
        Sampling rate that was declared, Hz.
    model : str
        Model of the arm that was asked for.
    calibration : Calibration
        What is known of the torque transducers.
    """

    config: dict[str, Any]
    truth: MBK | None
    seed: int | None
    timing: Timing | None
    reading: TorqueReading
    uncertainty: float
    rate: float | None
    model: str
    calibration: Calibration

    @classmethod
    def of(cls, metadata: Mapping[str, str], joints: int) -> Metadata:
        """Read the metadata of a bag, which may be empty.

        Parameters
        ----------
        metadata : mapping of str to str
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
        truth = _truth(metadata)
        if truth is not None and truth.joints != joints:
            raise DataError(f"metadata: truth is of {truth.joints} joints, the data of {joints}")
        seed = _parsed(metadata, "seed", None)
        uncertainty = _number(metadata, UNCERTAINTY_KEY)
        if uncertainty is not None and not 0.0 <= uncertainty <= 1.0:
            raise DataError(f"metadata: {UNCERTAINTY_KEY} is not a time in s: {uncertainty!r}")
        return cls(
            config=config,
            truth=truth,
            seed=seed if type(seed) is int else None,
            timing=Timing.from_metadata(metadata),
            reading=reading_of(metadata),
            uncertainty=LpmConfig.timing_uncertainty if uncertainty is None else uncertainty,
            rate=_number(metadata, RATE_KEY),
            model=_model(metadata),
            calibration=calibration_of(metadata),
        )


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
    others: dict[str, Any] = {
        name: value
        for key, name in READING_KEYS.items()
        if (value := _number(metadata, key, integer=name == "order")) is not None
    }
    try:
        return TorqueReading(timing=TorqueTiming(timing), **others)
    except ValidationError as error:
        raise DataError(f"metadata: {first_complaint(error)}") from None


def calibration_of(metadata: Mapping[str, str]) -> Calibration:
    """What the metadata of a bag declare of the transducers, else what is assumed of any.

    Raises
    ------
    DataError
        If something is there, but makes no sense.
    """
    declared = {
        name: _number(metadata, key) for key, name in CALIBRATION_KEYS.items() if key in metadata
    }
    if not declared:
        return Calibration.undeclared()
    if None in declared.values():
        raise DataError(f"metadata: uncertainty of the calibration is not a number: {declared!r}")
    try:
        return replace(
            Calibration.undeclared(), assumed=len(declared) < len(CALIBRATION_KEYS), **declared
        )
    except ConfigurationError as error:
        raise DataError(f"metadata: {error}") from None


def _model(metadata: Mapping[str, str]) -> str:
    try:
        return require_model(_parsed(metadata, MODEL_KEY, AUTO))
    except ConfigurationError as error:
        raise DataError(f"metadata: {error}") from None


def _truth(metadata: Mapping[str, str]) -> MBK | None:
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


def _number(metadata: Mapping[str, str], key: str, *, integer: bool = False) -> Any:
    value = _parsed(metadata, key, None)
    if value is not None and type(value) not in ((int,) if integer else (int, float)):
        kind = "an integer" if integer else "a number"
        raise DataError(f"metadata: {key} is not {kind}: {value!r}")
    return value


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


def latest_metadata(metadata: Sequence[Mapping[str, str]]) -> dict[str, str]:
    """Metadata of the first of some bags, with the timing that counts for all of them.

    Of one run it is that of the bag which knows most of it. Of several runs, as where a trial was
    made again, it is that of the run with most problems.

    Raises
    ------
    DataError
        If the timing of one makes no sense.
    """
    known = [one for one in map(Timing.from_metadata, metadata) if one is not None]
    if not known:
        return dict(metadata[0])
    latest = [one for one in known if not any(one.begins(other) for other in known)]
    worst = max(latest, key=lambda one: (len(one.problems), one.ticks))
    return {**metadata[0], RECORD_KEY: worst.model_dump_json()}
