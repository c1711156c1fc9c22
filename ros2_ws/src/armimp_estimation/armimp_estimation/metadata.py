"""The metadata of a recording: what is known of its experiment apart from the samples."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainSerializer,
    PlainValidator,
    TypeAdapter,
    ValidationError,
)

from armimp_common.arrays import FloatArray
from armimp_common.errors import ArmimpError, ConfigurationError, DataError
from armimp_common.realtime import LATE_NS, TimingLimits
from armimp_common.schema import matrix
from armimp_common.status import TimingFigures
from armimp_common.topics import CONTROLLER_NODE, RATE
from armimp_estimation.arm_models import AUTO, require_model
from armimp_estimation.fit import Calibration
from armimp_estimation.json_model import first_complaint
from armimp_estimation.mbk import MBK
from armimp_estimation.problems import Problem, ProblemCode, problem
from armimp_estimation.torque_timing import TorqueReading

CALIBRATION_KEYS = {
    "gain_uncertainty": "gain",
    "cross_talk_uncertainty": "cross_talk",
    "angle_uncertainty": "angle",
    "linearity_uncertainty": "linearity",
}
"""Attribute of `Calibration` by the metadata key that declares it."""
READING_KEYS = {
    "torque_timing": "timing",
    "torque_delay": "delay",
    "torque_cutoff": "cutoff",
    "torque_order": "order",
    "torque_uncertainty": "uncertainty",
    "actuator_lag": "actuator_lag",
}
"""Attribute of :class:`TorqueReading` by the key that declares it."""

_LARGEST_TRUTH = 1e12
"""Limit of the elements of true matrices, SI units: beyond any arm, but squares don't overflow."""
_MODEL_OF_LAW = 0.2
"""Assumption: standard error of the robot's inertia that a law was given, as laws bear it."""
RECORD_KEY = "timing"
"""Metadata key of the timing up to the end of a bag's trial, as JSON."""


class Timing(TimingFigures, TimingLimits):
    """Timing measured in real time, and its limits; durations in s."""

    model_config = ConfigDict(allow_inf_nan=True)

    @property
    def problems(self) -> list[Problem]:
        """Problems of figures beyond their limits; comparisons are written so that NaN fails."""
        found = []
        for code, count, limit in (
            (ProblemCode.SAMPLES_LATE, self.late, self.max_late_share),
            (ProblemCode.COMMANDS_LATE, self.missed, self.max_missed_share),
        ):
            share = count / self.ticks if self.ticks else 0.0
            if not share <= limit:
                values: dict[str, Any] = {"count": count, "ticks": self.ticks}
                values |= {"late_ms": LATE_NS / 1e6, "percent": 100.0 * share}
                found.append(problem(code, limit=100.0 * limit, **values))
        if not self.latency_p99 <= self.max_latency:
            ms, limit = 1e3 * self.latency_p99, 1e3 * self.max_latency
            found.append(problem(ProblemCode.LATENCY, ms=ms, limit=limit))
        return found

    def begins(self, other: Timing) -> bool:
        """Whether the other timing may be that of the same run at a later time."""
        limits = TimingLimits.model_fields
        return (
            all(getattr(self, name) == getattr(other, name) for name in limits)
            and self.ticks < other.ticks
            and self.late <= other.late
            and self.missed <= other.missed
            # Written so that NaN, which is not measured yet, contradicts nothing.
            and not self.period_max > other.period_max
            and not self.latency_max > other.latency_max
        )


def _matrices(value: Any) -> MBK | None:
    if value is None or isinstance(value, MBK):
        return value
    try:
        found = MBK(**{name: np.array(value[name], dtype=np.float64) for name in ("M", "B", "K")})
    except (LookupError, TypeError, ValueError, OverflowError, ArmimpError) as error:
        raise ValueError(f"not three matrices M, B, K: {error}") from None
    largest = max(float(np.max(np.abs(matrix))) for matrix in (found.M, found.B, found.K))
    if not largest < _LARGEST_TRUTH:
        raise ValueError(f"an element of {largest:g}, which no arm has")
    return found


def _lists(truth: MBK | None) -> dict[str, list[list[float]]] | None:
    names = () if truth is None else ("M", "B", "K")
    return {name: getattr(truth, name).tolist() for name in names} or None


Truth = Annotated[MBK | None, PlainValidator(_matrices), PlainSerializer(_lists)]
"""True matrices, if they are known; in JSON, lists of rows in SI units."""
_Declared = TypeAdapter(dict[str, Annotated[float, Field(strict=True)]])


class Metadata(BaseModel):
    """What is known of an experiment apart from its samples, by the keys that bags use."""

    model_config = ConfigDict(frozen=True, arbitrary_types_allowed=True)

    config: dict[str, Any] = {}
    """Configuration; empty if it is not known."""
    truth: Truth = None
    """True matrices, if they are known."""
    seed: Annotated[int | None, BeforeValidator(lambda v: v if type(v) is int else None)] = None
    """Seed of all random signals."""
    timing: Timing | None = None
    """Timing of a run in real time."""
    reading: TorqueReading = TorqueReading()
    """How torques were read."""
    calibration: Calibration = Calibration.undeclared()
    """Standard errors of the sensors: declared ones, or else those assumed for any sensor."""
    sampling_rate: Annotated[float | None, Field(strict=True)] = None
    """Declared sampling rate, if it is not a customary one, Hz."""
    arm_model: Annotated[str, AfterValidator(require_model)] = AUTO
    """Model of the arm that was requested."""
    robot_inertia: tuple[float, ...] | None = None
    """Declared inertia of the robot in the posture, row by row, kg·m²."""
    robot_inertia_uncertainty: Annotated[float, Field(ge=0.0, le=1.0)] = 0.05
    """Standard error of that, see :meth:`robot_of`; the default is an assumption."""

    @classmethod
    def of(cls, metadata: Mapping[str, str], joints: int | None = None) -> Metadata:
        """Read the metadata of a bag, which may be empty.

        Parameters
        ----------
        metadata : mapping of str to str
            JSON text by key.
        joints : int, optional
            Number of joints n of the data.

        Raises
        ------
        DataError
            If an entry is invalid, or the truth or the robot has another number of joints.
        """
        keys = (*cls.model_fields, *READING_KEYS, *CALIBRATION_KEYS)
        entries = {key: _parsed(metadata, key) for key in keys if key in metadata}
        try:
            declared = _Declared.validate_python(_named(entries, CALIBRATION_KEYS))
            assumed = not declared.keys() >= {"gain", "cross_talk", "angle"}
            sensors = replace(Calibration.undeclared(), assumed=assumed, **declared)
            # Of JSON, as only there the name of a timing stands for it strictly.
            properties = json.dumps(_named(entries, READING_KEYS))
            reading = TorqueReading.model_validate_json(properties, strict=True)
            found = cls.model_validate({**entries, "reading": reading, "calibration": sensors})
            if joints is not None:
                found.robot_of(joints)
        except ValidationError as error:
            given = f"{error.errors()[0]['input']!r:.60}"
            where, _, reason = first_complaint(error).partition(": ")
            if error.title != cls.__name__:  # attributes of readings and sensors have other names
                named = {name: key for key, name in (READING_KEYS | CALIBRATION_KEYS).items()}
                where = named.get(where, where)
            raise DataError(f"metadata: {where}: {reason}, got {given}") from None
        except ConfigurationError as error:
            raise DataError(f"metadata: {error}") from None
        if found.truth is not None and joints not in (None, found.truth.joints):
            raise DataError(
                f"metadata: truth is of {found.truth.joints} joints, the data of {joints}"
            )
        return found

    @property
    def planned_rate(self) -> float | None:
        """Sampling rate that was planned for a recording, Hz, if it is known."""
        if self.sampling_rate is None and CONTROLLER_NODE in self.config:
            return RATE  # the only one at which that controller works
        return self.sampling_rate

    def robot_of(self, joints: int) -> tuple[FloatArray, float] | None:
        """Return the known inertia of the robot, kg·m², (joints, joints), with its standard error.

        It is the declared one, else the one that the control law was given, else None. The standard
        error of each element M_ij is relative to ``√(M_ii M_jj)``.

        Raises
        ------
        ConfigurationError
            If the declared one has another size.
        """
        if self.robot_inertia is not None:
            declared = matrix("robot_inertia", self.robot_inertia, joints)
            return declared, self.robot_inertia_uncertainty
        try:
            given = matrix("", self._law["known.robot_inertia"], joints).astype(np.float64)
        except (LookupError, TypeError, ValueError, ArmimpError):
            return None
        return given, _MODEL_OF_LAW

    @property
    def _law(self) -> Mapping[str, Any]:
        law = self.config.get(CONTROLLER_NODE)
        return law if isinstance(law, Mapping) else {}

    @property
    def target(self) -> MBK | None:
        """Target impedance of the control law; None if the law has none or it is not known."""
        law = self._law
        if law.get("law.kind") != "imbic":
            return None
        try:
            parts = [np.diag(law[f"target.{one}"]) for one in ("inertia", "damping", "stiffness")]
            return MBK(**dict(zip("MBK", parts, strict=True)))
        except (LookupError, TypeError, ValueError, OverflowError, ArmimpError):
            return None


def _named(entries: Mapping[str, Any], names: Mapping[str, str]) -> dict[str, Any]:
    """Return metadata, without those that are null, by the names of the attributes."""
    return {name: entries[key] for key, name in names.items() if entries.get(key) is not None}


def _parsed(metadata: Mapping[str, str], key: str) -> Any:
    try:
        value = json.loads(metadata[key])
        # Half a surrogate pair can be read, but not be written again.
        json.dumps(value, ensure_ascii=False).encode()
    except (ValueError, RecursionError):
        raise DataError(f"metadata: {key} is not JSON: {metadata[key][:60]!r}") from None
    return value


def latest_metadata(metadata: Sequence[Mapping[str, str]]) -> dict[str, str]:
    """Return the metadata of the first of several bags, with one timing that counts for them all.

    For bags of one run, that is the timing that covers most of the run. For bags of several runs,
    as when a trial was repeated, it is the timing of the run with the most problems.

    Raises
    ------
    DataError
        If the metadata of a bag are invalid.
    """
    known = [timing for one in metadata if (timing := Metadata.of(one).timing) is not None]
    if not known:
        return dict(metadata[0])
    latest = [one for one in known if not any(one.begins(other) for other in known)]
    worst = max(latest, key=lambda one: (len(one.problems), one.ticks))
    return {**metadata[0], RECORD_KEY: worst.model_dump_json()}
