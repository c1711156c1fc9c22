"""The results of a study as tables of numbers, for other programs."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from typing import Final

from armimp_bringup.study.entry import StudyEntry
from armimp_bringup.study.verdict import (
    StudyVerdict,
    WorstValue,
    relative_error,
    scaled_error,
)

_CSV_COLUMNS: Final = (
    "friction", "resolution", "perturbation", "seed", "valid", "estimator", "row", "column",
    "vaf_percent", "r2", "coherence_derived", "coherence_torque", "coherence_motion",
    "lock_ratio", "bias_bound",
    "M", "M_se", "M_error_percent", "M_scaled_error_percent",
    "B", "B_se", "B_error_percent", "B_scaled_error_percent",
    "K", "K_se", "K_error_percent", "K_scaled_error_percent",
)  # fmt: skip


def results_csv(entries: Sequence[StudyEntry]) -> str:
    """Table with one row for each condition, element and estimator.

    Numbers have as many digits as it takes to read them back exactly; what is not known is empty.
    """
    text = io.StringIO()
    writer = csv.DictWriter(text, _CSV_COLUMNS, lineterminator="\n")
    writer.writeheader()
    for entry in entries:
        for name in entry.estimators:
            for i in range(entry.joints):
                for k in range(entry.joints):
                    writer.writerow(_row(entry, name, i, k))
    return text.getvalue()


def verdict_csv(verdict: StudyVerdict) -> str:
    """The worst values as a table."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(WorstValue.model_fields), lineterminator="\n")
    writer.writeheader()
    for one in verdict.worst:
        writer.writerow(one.model_dump())
    return text.getvalue()


def _row(entry: StudyEntry, name: str, i: int, k: int) -> dict[str, object]:
    result = entry.estimators[name]
    trial = next(one for one in entry.trials if one.k == k + 1)
    row: dict[str, object] = {
        "friction": entry.friction,
        "resolution": entry.resolution,
        "perturbation": entry.perturbation,
        "seed": entry.seed,
        "valid": entry.valid,
        "estimator": name,
        "row": i + 1,
        "column": k + 1,
        "vaf_percent": None if result.vaf is None else result.vaf[i][k],
        "r2": result.r2[i][k],
        "coherence_derived": result.coherence_derived[i][k],
        "coherence_torque": result.coherence_torque[i][k],
        "coherence_motion": result.coherence_motion[k],
        "lock_ratio": trial.lock_ratio[i],
        "bias_bound": trial.bias_bound[i],
    }
    for letter in ("M", "B", "K"):
        row[letter] = getattr(result, letter)[i][k]
        row[f"{letter}_se"] = getattr(result, f"{letter}_se")[i][k]
        row[f"{letter}_error_percent"] = relative_error(entry, name, letter, i, k)
        row[f"{letter}_scaled_error_percent"] = scaled_error(entry, name, letter, i, k)
    return {
        key: None if isinstance(value, float) and math.isnan(value) else value
        for key, value in row.items()
    }
