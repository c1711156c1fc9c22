"""Results in the form in which they are published."""

from __future__ import annotations

from collections.abc import Mapping

from diagnostic_msgs.msg import DiagnosticStatus

from armimp_common.arrays import ComplexArray, FloatArray
from armimp_common.status import Level, make_status
from armimp_common.topics import ESTIMATOR_NODE
from armimp_estimation.alignment.assemble import Trial
from armimp_estimation.frf import frf_matrix
from armimp_estimation.result import Result
from armimp_estimation.trial import TrialData

RESULT_NAME = f"{ESTIMATOR_NODE}: impedance"
_SHOWN = 16
"""Number of frequencies at which curves are published; files hold all."""


def column_message(data: TrialData, lost: int) -> DiagnosticStatus:
    """Tell column k of T, R and ``Z = T/R_kk`` as soon as its trial is over.

    Raises
    ------
    DataError
        If the trial tells no responses.
    """
    frf = frf_matrix([data])
    R, T = frf.R[:, 0], frf.T[:, 0]
    column = data.joint + 1
    values = {"trial": data.record.trial, "joint": column, "lost": lost}
    curves = {
        f"{name}_{i + 1}{column}": row
        for name, curve in (("R", R), ("T", T), ("Z", T / R[data.joint]))
        for i, row in enumerate(curve)
    }
    text = f"trial {data.record.trial}: column {column} of the impedance"
    name = f"{ESTIMATOR_NODE}: column {column}"
    return make_status(name, Level.OK, text, {**values, **_selected(frf.f, curves)})


def failed_trial_message(trial: Trial, reason: str) -> DiagnosticStatus:
    """Say that a trial cannot be estimated, and why."""
    joint = trial.joint + 1
    values = {"trial": trial.trial, "joint": joint, "lost": trial.statistics.lost}
    return make_status(f"{ESTIMATOR_NODE}: column {joint}", Level.ERROR, reason, values)


def result_message(result: Result) -> DiagnosticStatus:
    """Tell M, B and K with standard errors, the scores, and Z at selected frequencies."""
    summary = result.summary
    codes = dict.fromkeys(one.code.value for one in summary.faults)
    values: dict[str, str | bool | list[float]] = {
        "valid": summary.valid,
        "problems": " ".join(codes),
    }
    for name, found in summary.estimators.items():
        for key in ("M", "B", "K", "M_se", "B_se", "K_se", "vaf", "r2", "coherence_derived"):
            matrix = getattr(found, key)
            if matrix is not None:
                values[f"{name}.{key}"] = [value for row in matrix for value in row]
    for name, curve in result.curves.items():
        elements = {
            f"Z_{i + 1}{k + 1}": element
            for i, row in enumerate(curve.Z)
            for k, element in enumerate(row)
        }
        chosen = _selected(curve.f, elements)
        values |= {f"{name}.{key}": numbers for key, numbers in chosen.items()}
    return make_status(
        RESULT_NAME,
        Level.OK if summary.valid else Level.ERROR,
        "valid" if summary.valid else f"not valid: {summary.faults[0]}",
        values,
    )


def _selected(f: FloatArray, curves: Mapping[str, ComplexArray]) -> dict[str, list[float]]:
    """Real and imaginary parts at up to 16 frequencies, evenly spread over their logarithm."""
    places = list(range(f.size))
    if f.size > _SHOWN:
        ratio = (f.size - 1) ** (1.0 / (_SHOWN - 1))
        places = sorted({0} | {round(ratio**power) for power in range(_SHOWN)})
    parts = {
        f"{name}.{part}": values[places].tolist()
        for name, curve in curves.items()
        for part, values in (("re", curve.real), ("im", curve.imag))
    }
    return {"f": f[places].tolist(), **parts}
