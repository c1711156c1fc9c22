"""All numbers of a study in one table: a row for each condition, estimator and element."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from armimp_bringup.study.store import StudyEntry
from armimp_estimation.mbk import MBK
from armimp_estimation.report.formats import setting

FloatArray = NDArray[np.float64]
Table: TypeAlias = NDArray[np.void]

LETTERS: Final = ("M", "B", "K")
FREQUENCIES: Final = np.linspace(0.122, 15.0, 200)
"""The band of the study, Hz."""
LEAST_COUNTS: Final = 5.0
"""Torque that an element must make to be judged with more than three joints, counts."""
_TYPE: Final = np.dtype(
    [
        *((name, np.int64) for name in ("friction", "resolution", "perturbation", "seed")),
        ("valid", np.bool_),
        ("estimator", np.object_),
        ("row", np.int64),
        ("column", np.int64),
        ("resolved", np.bool_),
        *(
            (name, np.float64)
            for name in (
                *("vaf_percent", "r2", "coherence_derived", "coherence_torque"),
                *("coherence_motion", "lock_ratio", "bias_bound"),
                *(
                    letter + suffix
                    for letter in LETTERS
                    for suffix in ("", "_se", "_error_percent", "_scaled_error_percent")
                ),
            )
        ),
    ]
)


def results_table(entries: Sequence[StudyEntry]) -> Table:
    """Table of the results of a study.

    Relative errors are those of an element of M, B or K against its true value. The scaled error of
    ``X_ik`` is relative to ``sqrt(|X_ii X_kk|)`` of the truth: what is tiny beside its diagonal may
    be wrong by far more than its own size, and still not matter.

    Parameters
    ----------
    entries : sequence of StudyEntry
        Results with the same estimators and number of joints, at least one.

    Returns
    -------
    ndarray, shape (n_conditions, n_estimators, n, n)
        Structured; rows and columns of the elements are 1-based, errors in %.
    """
    n, names = entries[0].joints, list(entries[0].estimators)
    table = np.zeros((len(entries), len(names), n, n), dtype=_TYPE)
    table["row"] = np.arange(1, n + 1)[:, np.newaxis]
    table["column"] = np.arange(1, n + 1)
    for entry, of_entry in zip(entries, table, strict=True):
        assert entry.truth is not None  # these are simulations
        truth = entry.truth.mbk()
        for name in ("friction", "resolution", "perturbation", "seed", "valid"):
            of_entry[name] = getattr(entry, name)
        of_entry["resolved"] = resolved(entry, truth)
        for trial in entry.trials:
            of_entry["lock_ratio"][..., trial.k - 1] = trial.lock_ratio
            of_entry["bias_bound"][..., trial.k - 1] = trial.bias_bound
        for name, rows in zip(names, of_entry, strict=True):
            result = entry.estimators[name]
            rows["estimator"] = name
            rows["vaf_percent"] = result.vaf
            for score in ("r2", "coherence_derived", "coherence_torque", "coherence_motion"):
                rows[score] = getattr(result, score)
            for letter in LETTERS:
                rows[letter] = getattr(result, letter)
                rows[f"{letter}_se"] = getattr(result, f"{letter}_se")
                true = getattr(truth, letter)
                off = 100.0 * (rows[letter] - true)
                rows[f"{letter}_error_percent"] = _over(off, np.abs(true))
                rows[f"{letter}_scaled_error_percent"] = _over(off, scale(true))
    return table


def scale(true: FloatArray) -> FloatArray:
    """Size ``sqrt(|X_ii X_kk|)`` that the diagonal of a matrix gives to each element, (n, n)."""
    diagonal = np.abs(np.diag(true))
    return np.asarray(np.sqrt(np.outer(diagonal, diagonal)))


def _over(values: FloatArray, size: FloatArray) -> FloatArray:
    """Quotient; NaN where the size is zero."""
    return np.divide(values, size, out=np.full_like(values, np.nan), where=size != 0.0)


def torque_in_counts(entry: StudyEntry, truth: MBK, f: FloatArray) -> FloatArray | None:
    """Torque that each element makes in one condition, beside the resolution of the transducers.

    That is ``peak_k / count`` times the rms of ``|Z_ik / (M_rd s² + B_rd s + K_rd + Z_kk)|`` over
    the frequencies: what a perturbation at its peak would cause if its spectrum were flat there.

    Parameters
    ----------
    entry : StudyEntry
        Result with its configuration.
    truth : MBK
        True matrices.
    f : ndarray
        Frequencies, Hz; zero alone gives the largest static torque of the stiffness.

    Returns
    -------
    ndarray, shape (n, n)
        Counts; None if torques are not quantised, or the configuration does not tell.
    """
    count = setting(entry.config, "arm_sim", "sensors.torque_resolution")
    names = ("perturbation.peak", "target.inertia", "target.damping", "target.stiffness")
    found = [setting(entry.config, "imbic_controller", name) for name in names]
    known = all(isinstance(values, list) and len(values) == len(truth.M) for values in found)
    if not isinstance(count, float) or count <= 0.0 or not known:
        return None
    peak, inertia, damping, stiffness = (np.array(values, dtype=np.float64) for values in found)
    z = truth.impedance(f)
    target = MBK(M=np.diag(inertia), B=np.diag(damping), K=np.diag(stiffness)).impedance(f)
    yielding = np.einsum("kkf->kf", z + target)
    gain = np.sqrt(np.mean(np.abs(z / yielding) ** 2, axis=2))
    return np.asarray(gain * peak / count)


def resolved(entry: StudyEntry, truth: MBK) -> NDArray[np.bool_]:
    """Elements that are judged: with more than three joints, those of more than five counts."""
    counts = torque_in_counts(entry, truth, FREQUENCIES) if entry.joints > 3 else None
    if counts is None:
        return np.ones(truth.M.shape, dtype=np.bool_)
    return np.asarray(counts > LEAST_COUNTS)


def results_csv(table: Table) -> str:
    """The table as text.

    Numbers have as many digits as it takes to read them back exactly; what is not known is empty.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_TYPE.names or ())
    for row in table.ravel():
        writer.writerow(
            "" if isinstance(value, float) and math.isnan(value) else value for value in row.item()
        )
    return text.getvalue()


# --- levels, as Figures 3 and 4 of the paper show them ------------------------------------------

MOST_JOINTS: Final = 3
"""With more of them, elements are drawn by the row; there would be too many marks."""


@dataclass(frozen=True, kw_only=True)
class LevelScore:
    """A score of Figure 3 or 4: its field of the results, name, unit, and quantity with targets."""

    field: str
    name: str
    unit: str = ""
    quantity: str = ""

    def subjects(self, table: Table) -> Mapping[tuple[str, str], FloatArray]:
        """Values, shape (n_conditions, n_elements), by symbol and 1-based indices of their marks.

        Parameters
        ----------
        table : ndarray, shape (n_conditions, n, n)
            Results of one estimator.
        """
        values, n = table[self.field], table.shape[-1]
        if self.field == "coherence_motion":
            return {("θ", f"{k + 1}"): values[:, 0, k, np.newaxis] for k in range(n)}
        if n > MOST_JOINTS:
            return {("Z", f"{i + 1}·"): values[:, i] for i in range(n)}
        return {
            ("Z", f"{i + 1}{k + 1}"): values[:, i, k, np.newaxis]
            for i in range(n)
            for k in range(n)
        }


FIT_SCORES: Final = (
    LevelScore(field="vaf_percent", name="VAF", unit="%", quantity="VAF"),
    LevelScore(field="r2", name="R²", quantity="R²"),
)
"""Those of Figure 3."""
COHERENCE_SCORES: Final = (
    LevelScore(field="coherence_derived", name="derived coherence", quantity="derived coherence"),
    LevelScore(field="coherence_torque", name="coherence τΔ → τ"),
    LevelScore(field="coherence_motion", name="coherence τΔ → θ"),
)
"""Band means, those of Figure 4."""


def statistics(
    table: Table, factor: str, values: FloatArray
) -> tuple[list[int], FloatArray, FloatArray, FloatArray]:
    """Levels of a factor; mean, smallest and largest of (n_conditions, n_elements) values there."""
    levels = table[factor][:, 0, 0]
    present = np.unique(levels)
    groups = [values[levels == level] for level in present]
    mean, low, high = (np.array([of(one) for one in groups]) for of in (np.mean, np.min, np.max))
    return present.tolist(), mean, low, high
