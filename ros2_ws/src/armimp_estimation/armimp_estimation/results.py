"""Files of a result: ``summary.json`` for the figures, ``frf.npz`` for the curves."""

import math
import shlex
from collections.abc import Mapping, Sequence, Sized
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, JsonValue, ValidationError, model_validator

from armimp_common.errors import DataError
from armimp_estimation.alignment.stream_statistics import StreamStatistics
from armimp_estimation.arm_models import ModelFit, supported
from armimp_estimation.atomic_write import open_regular, read_bytes, write_whole
from armimp_estimation.curve_checks import UNREADABLE, check_curve
from armimp_estimation.identify import EstimatorResult, Identification
from armimp_estimation.json_model import JsonModel, Matrix, Number, Vector, first_complaint
from armimp_estimation.mbk import MBK
from armimp_estimation.problems import Concern, Problem, Severity, spoiled
from armimp_estimation.scores import Coherences
from armimp_estimation.torque_timing import ReadingSummary

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Complex64Array = NDArray[np.complex64]


_MOST_BYTES_OF_CURVES: Final = 512 << 20

Intervals = list[Matrix]
"""Lower and upper end of an interval for each element of a matrix."""
NORMAL_95 = 1.959963984540054
"""Standard errors on either side of an estimate that make a 95 % confidence interval."""


_COUNTS = ("duplicated", "contradictory", "reordered", "late")


class StreamSummary(JsonModel):
    """The messages of one stream within a trial, see `alignment.stream_statistics`."""

    expected: int
    received: int
    lost: int
    duplicated: int
    contradictory: int
    reordered: int
    late: int


class FindingSummary(JsonModel):
    """A problem as data, see `armimp_estimation.problems`, with its sentence."""

    code: str
    concern: str
    severity: str
    trial: int | None
    estimator: str
    values: dict[str, JsonValue]
    sentence: str

    @classmethod
    def of(cls, problem: Problem) -> "FindingSummary":
        """Summary of one problem."""
        values: dict[str, JsonValue] = {
            name: None if isinstance(value, float) and not math.isfinite(value) else value
            for name, value in problem.values.items()
        }
        return cls(
            code=problem.code.value,
            concern=problem.concern.value,
            severity=problem.severity.value,
            trial=problem.trial,
            estimator=problem.estimator,
            values=values,
            sentence=problem.sentence,
        )


class VerdictSummary(JsonModel):
    """The two verdicts: whether Z(f), and whether M, B and K, are right within their intervals."""

    impedance: bool
    parameters: bool


class DelaySummary(JsonModel):
    """Delay of torques against angles that was fitted, s; see `armimp_estimation.fit`."""

    delay: Number
    error: Number
    told: Number
    told_error: Number
    refuted: bool


class ModelParameterSummary(JsonModel):
    """One parameter: numbers row by row, as many as a matrix, the joints, or one; SI units."""

    values: Vector
    errors: Vector
    """Standard errors; null for what was not fitted."""
    unit: str


class ModelSummary(JsonModel):
    """A model of the arm beside M, B and K, see `armimp_estimation.arm_models`."""

    equation: str
    parameters: dict[str, ModelParameterSummary]
    lack_of_fit: Matrix
    held_out: Number
    """Mean lack of fit of bins that had no part in the fit."""
    criterion: Number
    """Bayesian information criterion."""
    fits: bool

    @classmethod
    def of(cls, fit: ModelFit) -> "ModelSummary":
        """Summary of a fitted model."""
        parameters = {
            one.name: {
                "values": fit.values[one.name].ravel().tolist(),
                "errors": fit.errors[one.name].ravel().tolist(),
                "unit": one.unit,
            }
            for one in fit.model.parameters
        }
        return cls.model_validate(
            {
                "equation": fit.model.equation,
                "parameters": parameters,
                "lack_of_fit": fit.lack.tolist(),
                "held_out": fit.held_out,
                "criterion": fit.criterion,
                "fits": fit.fits,
            }
        )


class TrialSummary(JsonModel):
    """One trial: ``k`` is the perturbed joint, 1-based; ``lost`` the samples that are missing."""

    k: int
    bag: str | None
    ticks: int
    lost: int
    lock_ratio: Vector
    bias_bound: Vector
    rtf: Number = math.nan
    """Times real time at which the trial ran; null if it was not run live."""
    duplicated: int = 0
    contradictory: int = 0
    reordered: int = 0
    late: int = 0
    clipped: int = 0
    excluded: Number = 0.0
    """Share of the samples that the estimates leave out, from 0 to 1."""
    stretches: int = 1
    """Runs of samples between those."""
    saved: Number = 0.0
    """Time (s) by which the trial was shorter than planned, as its errors were small enough."""
    streams: dict[str, StreamSummary] = Field(default_factory=dict)
    """By topic of the contract; empty if there are no messages behind the trial."""

    @classmethod
    def of(
        cls, ledger: "TrialLedger", joint: int, *, lock_ratio: Vector, bias_bound: Vector
    ) -> "TrialSummary":
        """Summary of the trial that perturbed a joint, 0-based."""
        about = {}
        if (samples := ledger.samples) is not None:
            about = {
                **{kind: samples.total(kind) for kind in _COUNTS},
                "clipped": samples.clipped,
                "excluded": samples.excluded_share,
                "stretches": samples.stretches,
                "streams": samples.to_dict(),
            }
        return cls.model_validate(
            {
                "k": joint + 1,
                "bag": ledger.bag,
                "ticks": ledger.ticks,
                "lost": ledger.lost,
                "lock_ratio": lock_ratio,
                "bias_bound": bias_bound,
                "rtf": ledger.rtf,
                "saved": ledger.saved,
                **about,
            }
        )


class EstimatorSummary(JsonModel):
    """Result of one estimator; matrices are lists of rows, SI units, VAF in %."""

    M: Matrix
    B: Matrix
    K: Matrix
    M_se: Matrix
    B_se: Matrix
    K_se: Matrix
    M_ci: Intervals
    B_ci: Intervals
    K_ci: Intervals
    covariance: Matrix
    lack_of_fit: Matrix
    vaf: Matrix | None
    r2: Matrix
    coherence_derived: Matrix
    coherence_torque: Matrix
    coherence_motion: Vector
    lack_limit: Number = math.nan
    """Lack of fit beyond which M, B and K are not valid."""
    verdict: VerdictSummary = VerdictSummary(impedance=False, parameters=False)
    """Whether its own numbers can be trusted."""
    delay: DelaySummary | None = None
    """Delay that was corrected, if one was left open."""
    models: dict[str, ModelSummary] = Field(default_factory=dict)
    """Models of the arm that were fitted beside M, B and K."""
    model: str | None = None
    """Of these the one that the data support."""

    @classmethod
    def of(cls, result: EstimatorResult, verdict: VerdictSummary) -> "EstimatorSummary":
        """Summary of the result of one estimator."""
        fit = result.fit
        values = {name: getattr(fit.mbk, name) for name in ("M", "B", "K")}
        errors = {name: getattr(fit, f"{name}_se") for name in values}
        ends = np.array((-NORMAL_95, NORMAL_95))
        best = supported(result.models)
        return cls.model_validate(
            {
                **{name: found.tolist() for name, found in values.items()},
                **{f"{name}_se": found.tolist() for name, found in errors.items()},
                **{
                    f"{name}_ci": (
                        values[name][..., None] + ends * errors[name][..., None]
                    ).tolist()
                    for name in values
                },
                "covariance": fit.covariance.tolist(),
                "lack_of_fit": fit.lack.tolist(),
                "lack_limit": fit.lack_limit,
                "verdict": verdict,
                "delay": None if fit.delay is None else DelaySummary(**vars(fit.delay)),
                "models": {one.model.name: ModelSummary.of(one) for one in result.models},
                "model": None if best is None else best.model.name,
                "vaf": None if result.vaf is None else result.vaf.tolist(),
                "r2": fit.r2.tolist(),
                "coherence_derived": result.coherence_derived.tolist(),
                "coherence_torque": result.coherence_torque.tolist(),
                "coherence_motion": result.coherence_motion.tolist(),
            }
        )


class TruthSummary(JsonModel):
    """True matrices, SI units."""

    M: Matrix
    B: Matrix
    K: Matrix

    @classmethod
    def of(cls, truth: MBK) -> "TruthSummary":
        """Summary of true matrices."""
        return cls(M=truth.M.tolist(), B=truth.B.tolist(), K=truth.K.tolist())

    def mbk(self) -> MBK:
        """Matrices as arrays."""
        return MBK(M=np.array(self.M), B=np.array(self.B), K=np.array(self.K))


class TimingSummary(JsonModel):
    """Timing of a run in real time, and its limits; see `armimp_common.realtime`."""

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


class WallSummary(JsonModel):
    """Wall time of a run from the command line, s; see `armimp_bringup.presentation`."""

    before: Number
    trials: Number
    after: Number
    result: Number = math.nan
    """From the last sample until M, B and K are on the screen, a part of what is after it."""


class OriginSummary(JsonModel):
    """How a result came about."""

    command: str
    """Command line."""
    date: str
    """When it was made: local time with its distance from UTC, ISO 8601."""

    @classmethod
    def of(cls, arguments: Sequence[str]) -> "OriginSummary":
        """That of a command which runs now, from its program and arguments."""
        program, *others = arguments
        date = datetime.now().astimezone().isoformat(" ", timespec="minutes")
        return cls(command=shlex.join([Path(program).name, *others]), date=date)


class Summary(JsonModel):
    """Content of ``summary.json``."""

    schema_version: Literal[1] = Field(default=1, alias="schema")
    config: dict[str, JsonValue]
    joints: int = Field(ge=1)
    joint_names: list[str]
    seed: int | None
    valid: bool
    problems: list[str]
    verdict: VerdictSummary = VerdictSummary(impedance=False, parameters=False)
    """The verdicts; the result is valid if both are."""
    findings: list[FindingSummary] = Field(default_factory=list)
    """Problems as data, and what was found and put right."""
    trials: list[TrialSummary]
    estimators: dict[str, EstimatorSummary]
    truth: TruthSummary | None
    timing: TimingSummary | None = None
    """Of a run in real time."""
    wall: WallSummary | None = None
    """Of a run from the command line."""
    torque_reading: ReadingSummary | None = None
    """What is known of the torque readings, and so was corrected."""
    origin: OriginSummary | None = None
    """Of a result from the command line."""

    def judged(self, problems: Sequence[str]) -> "Summary":
        """Return the same with these problems in the place of its own, and verdicts to match."""
        lesser = {one.sentence for one in self.findings if one.concern == Concern.PARAMETERS.value}
        verdict = VerdictSummary(impedance=lesser.issuperset(problems), parameters=not problems)
        update = {"valid": not problems, "problems": list(problems), "verdict": verdict}
        return self.model_copy(update=update)

    @model_validator(mode="after")
    def _check_shapes(self) -> "Summary":
        self._check_length("joint_names", self.joint_names)
        for name, estimator in self.estimators.items():
            self._check_matrices(f"estimators.{name}", estimator)
            self._check_length(f"estimators.{name}.coherence_motion", estimator.coherence_motion)
            parameters = 3 * self.joints**2
            if any(
                size != parameters
                for size in (len(estimator.covariance), *map(len, estimator.covariance))
            ):
                raise ValueError(f"estimators.{name}.covariance is not of {parameters} parameters")
        if self.truth is not None:
            self._check_matrices("truth", self.truth)
        for number, trial in enumerate(self.trials):
            if not 1 <= trial.k <= self.joints:
                raise ValueError(f"trials.{number}.k = {trial.k} is none of {self.joints} joints")
            self._check_length(f"trials.{number}.lock_ratio", trial.lock_ratio)
            self._check_length(f"trials.{number}.bias_bound", trial.bias_bound)
        return self

    def _check_matrices(self, name: str, part: JsonModel) -> None:
        for field, value in part:
            if isinstance(value, list) and field not in ("coherence_motion", "covariance"):
                self._check_length(f"{name}.{field}", value)
                for row in value:
                    self._check_length(f"a row of {name}.{field}", row)

    def _check_length(self, name: str, values: Sized) -> None:
        if len(values) != self.joints:
            raise ValueError(f"{name} has {len(values)} values for {self.joints} joints")


@dataclass(frozen=True, kw_only=True)
class TrialLedger:
    """What is known of a trial besides its samples.

    Parameters
    ----------
    bag : str or None
        Bag that holds it.
    ticks : int
        Samples of the trial.
    lost : int
        Samples found missing.
    rtf : float
        Times real time at which it ran; NaN if it was not run live.
    saved : float
        Time by which it ended earlier than planned, s.
    samples : StreamStatistics or None
        The account of its messages, if it was made from messages.
    """

    bag: str | None
    ticks: int
    lost: int = 0
    rtf: float = math.nan
    saved: float = 0.0
    samples: StreamStatistics | None = None


def summarise(
    identification: Identification,
    ledgers: Mapping[int, TrialLedger],
    *,
    config: Mapping[str, JsonValue],
    seed: int | None,
    problems: tuple[str, ...] = (),
    findings: Sequence[Problem] | None = None,
    timing: TimingSummary | None = None,
) -> Summary:
    """Put an identification into the form of ``summary.json``.

    Parameters
    ----------
    identification : Identification
        Result.
    ledgers : mapping of int to TrialLedger
        For each perturbed joint, 0-based.
    config : mapping
        Full configuration of the run.
    seed : int or None
        Seed of the run.
    problems : tuple of str
        Problems of the run itself, which come first and make the result invalid.
    findings : sequence of Problem, optional
        Those of the identification and of its trials; by default those of the identification.
    timing : TimingSummary, optional
        Of a run in real time.

    Raises
    ------
    DataError
        If a trial has no ledger.
    """
    trials = []
    for trial in identification.trials:
        if trial.joint not in ledgers:
            raise DataError(f"nothing known about the trial of joint {trial.joint + 1}")
        trials.append(
            TrialSummary.of(
                ledgers[trial.joint],
                trial.joint,
                lock_ratio=trial.lock_ratio.tolist(),
                bias_bound=trial.bias_bound.tolist(),
            )
        )
    known = identification.problems if findings is None else findings
    deciding = identification.deciding
    heavy = [one for one in known if one.severity is Severity.ERROR]
    # What concerns an estimator that decides nothing stands beside its own numbers.
    everything = [*problems, *(p.sentence for p in heavy if p.estimator in ("", *deciding))]

    def verdict_of(*estimators: str) -> VerdictSummary:
        holds = {
            concern: not problems and not any(spoiled(known, concern, one) for one in estimators)
            for concern in Concern
        }
        return VerdictSummary(
            impedance=holds[Concern.IMPEDANCE], parameters=holds[Concern.PARAMETERS]
        )

    return Summary(
        config=dict(config),
        joints=len(identification.joint_names),
        joint_names=list(identification.joint_names),
        seed=seed,
        valid=not everything,
        problems=everything,
        verdict=verdict_of(*deciding),
        findings=[FindingSummary.of(one) for one in known],
        trials=trials,
        estimators={
            name: EstimatorSummary.of(result, verdict_of(name))
            for name, result in identification.estimators.items()
        },
        truth=None if identification.truth is None else TruthSummary.of(identification.truth),
        timing=timing,
    )


def write_summary(path: Path, summary: Summary, *, anew: bool = False) -> None:
    """Write ``summary.json``; numbers have as many digits as it takes to read them back exactly.

    Parameters
    ----------
    path : Path
        The file.
    summary : Summary
        Its content.
    anew : bool
        Whether to put it in the place of a file that is there, which stays if that fails.

    Raises
    ------
    DataError
        If the file exists already or cannot be written.
    """
    text = summary.model_dump_json(indent=1, by_alias=True) + "\n"
    write_whole(path, lambda part: part.write_text(text, encoding="utf-8"), anew=anew)


def read_summary(path: Path) -> Summary:
    """Read ``summary.json``.

    Raises
    ------
    DataError
        If it cannot be read or is not a summary of schema 1; the message names file and place.
    """
    try:
        return Summary.model_validate_json(read_bytes(path))
    except OSError as error:
        raise DataError(f"{path}: {error.strerror}") from error
    except ValidationError as error:
        raise DataError(f"{path}: not a summary: {first_complaint(error)}") from error


@dataclass(frozen=True, kw_only=True, eq=False)
class ImpedanceCurve:
    """What an estimator found over frequency, as ``frf.npz`` holds it.

    Attributes
    ----------
    f : ndarray, shape (n_freq,)
        Frequencies, Hz.
    Z, T, R : ndarray, shape (n, n, n_freq)
        Impedance (N·m/rad), and responses of torques and of angles (rad/(N·m)) behind it.
    variance : ndarray, shape (n, n, n_freq)
        Variance of each complex value of Z.
    averages : float
        Effective number of averages behind it, for confidence bands.
    correlation : ndarray, shape (lags,)
        Of the errors at neighbouring frequencies.
    systematics : ndarray, shape (errors, n, n, n_freq)
    covariance, disturbance, inverse : ndarray or None
        As those of :class:`armimp_estimation.estimators.estimate.ImpedanceEstimate`; the first two
        in single precision.
    coherence : Coherences
        Over the frequencies of the spectra.
    """

    f: FloatArray
    Z: ComplexArray
    T: ComplexArray
    R: ComplexArray
    variance: FloatArray
    averages: float
    correlation: FloatArray
    covariance: Complex64Array | None
    disturbance: Complex64Array | None
    inverse: ComplexArray | None
    systematics: ComplexArray
    coherence: Coherences

    @classmethod
    def of(cls, result: EstimatorResult) -> "ImpedanceCurve":
        """That of a result, as it comes back from the file."""
        estimate = result.estimate
        covariance, disturbance = (
            None if values is None else values.astype(np.complex64)
            for values in (estimate.covariance, estimate.disturbance)
        )
        return cls(
            f=estimate.f,
            Z=estimate.Z,
            T=estimate.T,
            R=estimate.R,
            variance=estimate.variance,
            averages=estimate.averages,
            correlation=estimate.bin_correlation,
            covariance=covariance,
            disturbance=disturbance,
            inverse=estimate.inverse,
            systematics=np.array(estimate.systematics).reshape(-1, *estimate.Z.shape),
            coherence=result.coherence,
        )


def write_frf(path: Path, results: Mapping[str, EstimatorResult]) -> None:
    """Write ``frf.npz``; ``docs/interfaces.md`` lists its arrays.

    ``f`` is the grid of the first estimator; one with another grid has its own ``f_<name>``.

    Raises
    ------
    DataError
        If there is no estimate, or the file exists already or cannot be written.
    """
    if not results:
        raise DataError(f"{path}: no estimate to write")
    first = next(iter(results.values()))
    common, spectra = first.estimate.f, first.coherence
    arrays: dict[str, NDArray[Any] | None] = {
        "f": common,
        "f_coherence": spectra.f,
        "coherence_motion": spectra.motion,
        "coherence_torque": spectra.torque,
    }
    for name, result in results.items():
        curve = ImpedanceCurve.of(result)
        arrays |= {
            f"f_{name}": None if np.array_equal(curve.f, common) else curve.f,
            f"Z_{name}": curve.Z,
            f"T_{name}": curve.T,
            f"R_{name}": curve.R,
            f"var_{name}": curve.variance,
            f"averages_{name}": np.array(curve.averages),
            f"correlation_{name}": curve.correlation,
            f"covariance_{name}": curve.covariance,
            f"disturbance_{name}": curve.disturbance,
            f"inverse_{name}": curve.inverse,
            f"systematics_{name}": curve.systematics,
            f"derived_{name}": curve.coherence.derived,
        }

    def save(part: Path) -> None:
        known = {name: values for name, values in arrays.items() if values is not None}
        with part.open("wb") as file:
            np.savez(file, allow_pickle=False, **known)

    write_whole(path, save)


def read_frf(path: Path) -> dict[str, ImpedanceCurve]:
    """Read ``frf.npz``: the curves by name of the estimator.

    Raises
    ------
    DataError
        If it cannot be read or lacks an array.
    """
    try:
        # Opened here, as numpy leaves a file that it cannot read open.
        with open_regular(path) as raw, np.load(raw, allow_pickle=False) as file:
            size = sum(entry.file_size for entry in file.zip.infolist())
            if size > _MOST_BYTES_OF_CURVES:
                raise ValueError(f"it holds {size} bytes")
            names = [key[2:] for key in file.files if key.startswith("Z_")]
            curves = {name: _curve(file, name) for name in names}
        for name, curve in curves.items():
            check_curve(name, curve)
    except UNREADABLE as error:
        told = getattr(error, "strerror", None) or str(error)
        reason = " ".join(told.split()) or type(error).__name__
        raise DataError(f"{path}: not a file of impedance curves: {reason}") from error
    return curves


def _curve(file: Any, name: str) -> ImpedanceCurve:
    def optional(kind: str) -> Any:
        key = f"{kind}_{name}"
        return file[key] if key in file.files else None

    own = optional("f")
    return ImpedanceCurve(
        f=file["f"] if own is None else own,
        Z=file[f"Z_{name}"],
        T=file[f"T_{name}"],
        R=file[f"R_{name}"],
        variance=file[f"var_{name}"],
        averages=float(file[f"averages_{name}"]),
        correlation=file[f"correlation_{name}"],
        covariance=optional("covariance"),
        disturbance=optional("disturbance"),
        inverse=optional("inverse"),
        systematics=file[f"systematics_{name}"],
        coherence=Coherences(
            f=file["f_coherence"],
            motion=file["coherence_motion"],
            torque=file["coherence_torque"],
            derived=file[f"derived_{name}"],
        ),
    )
