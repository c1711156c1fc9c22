"""Results and progress in the form in which they are published."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticStatus

from armimp_common.status import Level, TrialStatus, make_status
from armimp_common.topics import ESTIMATOR_NODE
from armimp_estimation.alignment.assemble import AssembledTrial
from armimp_estimation.conclusion import Conclusion
from armimp_estimation.estimators.estimate import ImpedanceColumn
from armimp_estimation.estimators.lpm import FittedColumn
from armimp_estimation.identify import Identification
from armimp_estimation.stopping import largest_error
from armimp_estimation.trial import TrialSpectra

CONCLUSION_NAME = f"{ESTIMATOR_NODE}: impedance"
PROGRESS_NAME = f"{ESTIMATOR_NODE}: progress"
_SHOWN = 16
"""Number of frequencies at which curves are published; files hold all."""


def column_message(
    assembled: AssembledTrial, trial: TrialSpectra, column: ImpedanceColumn
) -> DiagnosticStatus:
    """Column k of T, R and Z_h at selected frequencies, as soon as its trial is over."""
    chosen = _selection(column.f.size)
    values: dict[str, str | int | list[float]] = {
        "trial": assembled.trial,
        "joint": column.joint + 1,
        "lost": assembled.ledger.lost,
        "f": column.f[chosen].tolist(),
    }
    power = trial.input_power
    for i in range(trial.joints):
        cross = {
            "R": trial.spectra.matrix[0, trial.position_channel(i)] / power,
            "T": trial.spectra.matrix[0, trial.torque_channel(i)] / power,
            "Z": column.Z[i],
        }
        for name, curve in cross.items():
            label = f"{name}_{i + 1}{column.joint + 1}"
            values[f"{label}.re"] = curve.real[chosen].tolist()
            values[f"{label}.im"] = curve.imag[chosen].tolist()
    return make_status(
        f"{ESTIMATOR_NODE}: column {column.joint + 1}",
        Level.OK,
        f"trial {assembled.trial}: column {column.joint + 1} of the impedance",
        values,
    )


def failed_trial_message(assembled: AssembledTrial, reason: str) -> DiagnosticStatus:
    """A trial which can't be estimated, and why."""
    joint = assembled.window.joint + 1
    return make_status(
        f"{ESTIMATOR_NODE}: column {joint}",
        Level.ERROR,
        reason,
        {"trial": assembled.trial, "joint": joint, "lost": assembled.ledger.lost},
    )


def conclusion_message(conclusion: Conclusion) -> DiagnosticStatus:
    """The whole matrix: M, B, K with standard errors, scores, and Z at selected frequencies."""
    summary = conclusion.summary
    values: dict[str, str | bool | list[float]] = {
        "valid": summary.valid,
        "problems": "; ".join(summary.problems),
    }
    for name, result in summary.estimators.items():
        for key in ("M", "B", "K", "M_se", "B_se", "K_se", "vaf", "r2", "coherence_derived"):
            matrix = getattr(result, key)
            if matrix is not None:
                values[f"{name}.{key}"] = [value for row in matrix for value in row]
    if conclusion.identification is not None:
        values |= _curves(conclusion.identification)
    return make_status(
        CONCLUSION_NAME,
        Level.OK if summary.valid else Level.ERROR,
        "valid" if summary.valid else f"not valid: {summary.problems[0]}",
        values,
    )


def progress_message(
    status: TrialStatus,
    *,
    samples: int,
    rate: float,
    coherence: tuple[float, float] | None,
    column: FittedColumn | None = None,
) -> DiagnosticStatus:
    """Where the recording stands; ``rate`` in samples per second of wall time."""
    values: dict[str, str | bool | int | float | list[float]] = {
        "trial": status.trial,
        "trials": status.trials,
        "joint": status.joint + 1,
        "phase": status.phase.value,
        "samples": samples,
        "planned": status.ticks,
        "rate": rate,
    }
    if coherence is not None:
        values["coherence_motion"], values["coherence_torque"] = coherence
    if column is not None:
        for letter, found, error in zip("MBK", column.values, column.errors, strict=True):
            values[letter], values[f"{letter}_se"] = found.tolist(), error.tolist()
        values["largest_error"] = largest_error(column)[0]
        values["preliminary"] = column.preliminary
    text = f"trial {status.trial} of {status.trials}: {samples} of {status.ticks}"
    return make_status(PROGRESS_NAME, Level.OK, text, values)


def _curves(identification: Identification) -> dict[str, str | bool | list[float]]:
    values: dict[str, str | bool | list[float]] = {}
    for name, result in identification.estimators.items():
        estimate = result.estimate
        chosen = _selection(estimate.f.size)
        values[f"{name}.f"] = estimate.f[chosen].tolist()
        for i in range(estimate.joints):
            for k in range(estimate.joints):
                curve = estimate.Z[i, k, chosen]
                values[f"{name}.Z_{i + 1}{k + 1}.re"] = curve.real.tolist()
                values[f"{name}.Z_{i + 1}{k + 1}.im"] = curve.imag.tolist()
    return values


def _selection(count: int) -> list[int]:
    """Indices of at most 16 frequencies, evenly spread over the logarithm."""
    if count <= _SHOWN:
        return list(range(count))
    ratio = (count - 1) ** (1.0 / (_SHOWN - 1))
    return sorted({round(ratio**i) for i in range(_SHOWN)} | {0})
