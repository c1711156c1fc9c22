"""The result in the form in which it is published."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticStatus

from armimp_common.status import Level, make_status
from armimp_common.topics import ESTIMATOR_NODE
from armimp_estimation.result import Result

RESULT_NAME = f"{ESTIMATOR_NODE}: impedance"


def result_message(result: Result) -> DiagnosticStatus:
    """Tell M, B and K with standard errors, and the scores; curves are in files."""
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
    return make_status(
        RESULT_NAME,
        Level.OK if summary.valid else Level.ERROR,
        "valid" if summary.valid else f"not valid: {summary.faults[0]}",
        values,
    )
