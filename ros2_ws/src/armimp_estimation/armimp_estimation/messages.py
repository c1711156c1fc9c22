"""The result in the form in which it is published."""

from __future__ import annotations

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus

from armimp_common.status import Level, make_status
from armimp_common.topics import ESTIMATOR_NODE
from armimp_estimation.result import Result

RESULT_NAME = f"{ESTIMATOR_NODE}: impedance"
_SHOWN = 16
"""Number of frequencies at which curves are published; files hold all."""


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
        chosen = _selection(curve.f.size)
        values[f"{name}.f"] = curve.f[chosen].tolist()
        for i, k in np.ndindex(curve.Z.shape[:2]):
            element = curve.Z[i, k, chosen]
            values[f"{name}.Z_{i + 1}{k + 1}.re"] = element.real.tolist()
            values[f"{name}.Z_{i + 1}{k + 1}.im"] = element.imag.tolist()
    return make_status(
        RESULT_NAME,
        Level.OK if summary.valid else Level.ERROR,
        "valid" if summary.valid else f"not valid: {summary.faults[0]}",
        values,
    )


def _selection(count: int) -> list[int]:
    """Indices of at most 16 frequencies, evenly spread over the logarithm."""
    if count <= _SHOWN:
        return list(range(count))
    ratio = (count - 1) ** (1.0 / (_SHOWN - 1))
    return sorted({round(ratio**i) for i in range(_SHOWN)} | {0})
