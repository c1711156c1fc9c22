"""The files of a result: its numbers are in ``summary.json``, its curves in ``frf.npz``."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, JsonValue, ValidationError, computed_field
from typing_extensions import Self

from armimp_common.errors import DataError
from armimp_estimation.alignment.stream_statistics import StreamStatistics
from armimp_estimation.arm_models import ModelFit, supported
from armimp_estimation.atomic_write import write_atomically, write_text
from armimp_estimation.estimators.estimate import ImpedanceEstimate
from armimp_estimation.fit import CommonDelay
from armimp_estimation.identify import EstimatorResult, Identification, TrialScores
from armimp_estimation.json_model import JsonModel, Matrix, Number, Vector, first_complaint
from armimp_estimation.metadata import Timing, Truth
from armimp_estimation.problems import Problem, Severity
from armimp_estimation.scores import NORMAL_95, Coherences
from armimp_estimation.torque_timing import TorqueReading
from armimp_estimation.verdict import Verdict, faults

SUMMARY_FILE = "summary.json"
FRF_FILE = "frf.npz"

Intervals = list[Matrix]
"""Lower and upper end of an interval for each element of a matrix."""


class TrialSummary(TrialScores, StreamStatistics):
    """One trial: its scores, and the counts of its samples."""

    bag: str | None = None
    """The bag: relative to the directory of the results after a run, else as it was given on the
    command line."""
    ticks: int
    """Samples of the trial: perturbation messages received."""
    rtf: Number = math.nan
    """Speed of the trial relative to real time; null if it was not run live."""
    saved: Number = 0.0
    """Time (s) by which the trial ended before its planned end, as its errors were small enough."""


class EstimatorSummary(JsonModel):
    """Result of one estimator; matrices are lists of rows, SI units, VAF in %."""

    M: Matrix
    """Inertia, kg·m²."""
    B: Matrix
    """Viscosity, N·m·s/rad."""
    K: Matrix
    """Stiffness, N·m/rad."""
    M_se: Matrix
    """Standard errors of M."""
    B_se: Matrix
    """Standard errors of B."""
    K_se: Matrix
    """Standard errors of K."""
    M_ci: Intervals
    """95 % confidence interval of each element of M, ``[lower, upper]``: 1.96 standard errors on
    either side."""
    B_ci: Intervals
    """The same of B."""
    K_ci: Intervals
    """The same of K."""
    covariance: Matrix
    """Covariance of the elements of M row by row, then of B, then of K, 3n² × 3n², SI units."""
    lack_of_fit: Matrix
    """Misfit of M s² + B s + K relative to that which noise explains."""
    vaf: Matrix | None
    """VAF, %; null where the truth is not known."""
    r2: Matrix
    """R² of the fit."""
    coherence_derived: Matrix
    """Band means of the derived coherence."""
    coherence_torque: Matrix
    """Band means of γ²(τ_Δ, τ_i) in trial k."""
    coherence_motion: Vector
    """Band means of γ²(τ_Δ, θ_k)."""
    coherence_limit: Number = math.nan
    """What the latter and the diagonal of the former must exceed, as unrelated signals don't."""
    lack_limit: Number = math.nan
    """Lack of fit beyond which M, B and K are not valid."""
    decides: bool = True
    """Whether problems of this estimator make the result not valid."""
    delay: CommonDelay | None = None
    """Delay between torques and angles that was fitted and corrected, if it was uncertain."""
    models: dict[str, ModelFit] = Field(default_factory=dict)
    """Models of the arm that were fitted in addition to M, B and K."""
    model: str | None = None
    """The one of these that was declared, or that the data support."""

    @property
    def offered(self) -> ModelFit | None:
        """Model whose M, B and K are reported in addition to these, if there is one."""
        return None if self.model is None else self.models.get(self.model)

    @classmethod
    def of(cls, result: EstimatorResult, *, decides: bool) -> EstimatorSummary:
        """Summarise the result of one estimator."""
        fit = result.fit
        ends = np.array((-NORMAL_95, NORMAL_95))
        found: dict[str, Any] = {
            f"coherence_{name}": getattr(result.coherence, name).mean(axis=-1)
            for name in ("derived", "torque", "motion")
        }
        found |= {name: getattr(fit, name) for name in ("covariance", "lack_limit", "r2")}
        found |= {name: getattr(result, name) for name in ("vaf", "coherence_limit")}
        for name, value, error in zip("MBK", fit.values, fit.errors, strict=True):
            found |= {name: value, f"{name}_se": error}
            found[f"{name}_ci"] = (value[..., None] + ends * error[..., None]).tolist()
        return cls(
            **found,
            lack_of_fit=fit.lack.tolist(),
            decides=decides,
            delay=fit.delay,
            models=result.models,
            model=supported(result.models),
        )


class WallSummary(JsonModel):
    """Wall time of a run from the command line, s; see `armimp_bringup.presentation`."""

    before: Number
    """From the start of the process to the first sample of the first trial: imports, discovery,
    lifecycle."""
    trials: Number
    """From there to the last perturbed sample of the last trial, including times between trials."""
    after: Number
    """From there until report and figures were written: the last rest, estimates, lifecycle."""
    result: Number = math.nan
    """The part of `after` until M, B and K were on the terminal; null with ``--json``."""


class OriginSummary(JsonModel):
    """Origin of a result: command line and date."""

    command: str
    """Command line."""
    date: str
    """When it was made: local time with its offset from UTC, ISO 8601."""

    @classmethod
    def of(cls, arguments: Sequence[str]) -> OriginSummary:
        """Describe the running command by its program and arguments."""
        program, *others = arguments
        date = datetime.now().astimezone().isoformat(" ", timespec="minutes")
        return cls(command=shlex.join([Path(program).name, *others]), date=date)


class Summary(JsonModel):
    """Content of ``summary.json``."""

    schema_version: Literal[1] = Field(default=1, alias="schema")
    """Version of this file, 1."""
    config: dict[str, JsonValue]
    """Configuration, as in the bags."""
    joints: int = Field(ge=1)
    """Number of joints n."""
    joint_names: list[str]
    """Their names, in the order of all matrices."""
    seed: int | None
    """Seed of the perturbation, if it is known."""
    problems: list[Problem]
    """What is wrong, and what was found and corrected, see below."""
    trials: list[TrialSummary]
    """The trials, see below."""
    estimators: dict[str, EstimatorSummary]
    """Results by name of the estimator, see below."""
    truth: Truth
    """``{"M": …, "B": …, "K": …}`` of the arm, if it was simulated."""
    timing: Timing | None = None
    """Timing of a run in real time, see below."""
    wall: WallSummary | None = None
    """Wall time of a run from the command line, see below."""
    torque_reading: TorqueReading | None = None
    """Known properties of the torque readings, which were corrected, see below; null if nothing
    could be estimated."""
    origin: OriginSummary | None = None
    """Command line and date of a result from the command line, see below."""

    @classmethod
    def of(cls, identification: Identification, **content: Any) -> Self:
        """Summarise an identification; all other fields are keywords, and taken as they are."""
        names, deciding = identification.joint_names, identification.deciding
        estimators = {
            name: EstimatorSummary.of(one, decides=name in deciding)
            for name, one in identification.estimators.items()
        }
        return cls(joints=len(names), joint_names=list(names), estimators=estimators, **content)

    @computed_field  # type: ignore[prop-decorator]
    @property
    def verdict(self) -> Verdict:
        """Whether Z(f), ``impedance``, and whether M, B and K, ``parameters``, can be trusted."""
        return Verdict.of(self.problems, *self.deciding)

    @computed_field  # type: ignore[prop-decorator]
    @property
    def valid(self) -> bool:
        """Whether both verdicts are good."""
        return self.verdict.parameters

    @property
    def faults(self) -> list[Problem]:
        """Problems that make the result not valid."""
        return faults(self.problems, *self.deciding)

    @property
    def refusals(self) -> list[Problem]:
        """Errors that affect only estimates which do not decide whether the result is valid."""
        errors = (one for one in self.problems if one.severity is Severity.ERROR)
        return [one for one in errors if one not in self.faults]

    @property
    def deciding(self) -> list[str]:
        """Names of the estimators that decide whether the result is valid."""
        return [name for name, one in self.estimators.items() if one.decides]

    def with_problems(self, problems: Sequence[Problem]) -> Self:
        """Return the summary with these problems, as far as they are new, ahead of its own."""
        new = [one for one in problems if one not in self.problems]
        return self.model_copy(update={"problems": [*new, *self.problems]})


def write_summary(path: Path, summary: Summary, *, anew: bool = False) -> None:
    """Write ``summary.json``, with as many digits as it takes to read numbers back exactly.

    Raises
    ------
    DataError
        If the file cannot be written, or exists already and `anew` is false.
    """
    write_text(path, summary.model_dump_json(indent=1, by_alias=True) + "\n", anew=anew)


def read_summary(path: Path) -> Summary:
    """Read ``summary.json``.

    Raises
    ------
    DataError
        If it cannot be read, or another version wrote it; the message names file and place.
    """
    try:
        return Summary.model_validate_json(path.read_bytes())
    except OSError as error:
        raise DataError(f"{path}: {error.strerror}") from error
    except ValidationError as error:
        raise DataError(f"{path}: not a summary: {first_complaint(error)}") from error


@dataclass(frozen=True, kw_only=True, eq=False)
class ImpedanceCurve(ImpedanceEstimate):
    """The part of an estimate that ``frf.npz`` holds, with covariances in single precision."""

    coherence: Coherences
    """Coherences at the frequencies of the spectra."""

    @classmethod
    def of(cls, result: EstimatorResult) -> ImpedanceCurve:
        """Return the curve of a result, in the precision of the file."""
        estimate = result.estimate
        kept = {name: getattr(estimate, name) for name in _ARRAYS}
        for name in ("covariance", "disturbance"):
            kept[name] = None if kept[name] is None else kept[name].astype(np.complex64)
        return cls(name=estimate.name, f=estimate.f, coherence=result.coherence, **kept)


_ARRAYS: Final = (
    *("Z", "T", "R", "noise", "averages", "bin_correlation"),
    *("covariance", "disturbance", "inverse", "systematics"),
)
"""Attributes of a curve that ``frf.npz`` holds, as arrays that also have the estimator's name; it
holds the variance, which follows from them, for other readers."""


def write_frf(path: Path, curves: Mapping[str, ImpedanceCurve]) -> None:
    """Write ``frf.npz``; ``docs/interfaces.md`` lists its arrays.

    ``f`` holds the frequencies of the first estimator; those of others, if different, are in
    ``f_<name>``.

    Raises
    ------
    DataError
        If the file exists already or cannot be written.
    """
    first = next(iter(curves.values()))
    arrays: dict[str, NDArray[Any] | None] = {
        "f": first.f,
        "f_coherence": first.coherence.f,
        "coherence_motion": first.coherence.motion,
        "coherence_torque": first.coherence.torque,
    }
    for name, curve in curves.items():
        arrays[f"f_{name}"] = None if np.array_equal(curve.f, first.f) else curve.f
        arrays |= {f"{one}_{name}": getattr(curve, one) for one in (*_ARRAYS, "variance")}
        arrays[f"systematics_{name}"] = np.array(curve.systematics).reshape(-1, *curve.Z.shape)
        arrays[f"derived_{name}"] = curve.coherence.derived

    def save(part: Path) -> None:
        known = {name: values for name, values in arrays.items() if values is not None}
        with part.open("wb") as file:
            np.savez(file, allow_pickle=False, **known)

    write_atomically(path, save)


def read_frf(path: Path) -> dict[str, ImpedanceCurve]:
    """Read ``frf.npz`` and return its curves by the name of their estimator.

    Raises
    ------
    DataError
        If it cannot be read, or another version wrote it.
    """
    try:
        with np.load(path) as file:
            names = [key[2:] for key in file.files if key.startswith("Z_")]
            return {name: _curve(file, name) for name in names}
    except (OSError, LookupError, ValueError) as error:
        raise DataError(f"{path}: not a file of impedance curves: {error}") from error


def _curve(file: Mapping[str, NDArray[Any]], name: str) -> ImpedanceCurve:
    """Make the curve of one estimator from its arrays."""
    kept = [one for one in _ARRAYS if f"{one}_{name}" in file]
    found: dict[str, Any] = {one: file[f"{one}_{name}"] for one in kept}
    found["averages"], found["systematics"] = float(found["averages"]), tuple(found["systematics"])
    coherence = Coherences(
        f=file["f_coherence"],
        motion=file["coherence_motion"],
        torque=file["coherence_torque"],
        derived=file[f"derived_{name}"],
    )
    f = file[f"f_{name}" if f"f_{name}" in file else "f"]
    return ImpedanceCurve(name=name, f=f, coherence=coherence, **found)
