"""What a report is made of: the files of a result directory and the bags behind them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from armimp_common.errors import ArmimpError, DataError
from armimp_estimation.alignment.assemble import AssembledTrial
from armimp_estimation.bags import BagContent, read_bag
from armimp_estimation.conclusion import FRF_FILE, SUMMARY_FILE
from armimp_estimation.results import ImpedanceCurve, Summary, read_frf, read_summary
from armimp_estimation.scores import coherence_significance
from armimp_estimation.verdict import Limits

_LIMITS = Limits()


@dataclass(frozen=True, kw_only=True, eq=False)
class Result:
    """A result and its evidence.

    Attributes
    ----------
    name : str
        Of the result, for titles.
    summary : Summary
        Numbers and verdict.
    curves : mapping of str to ImpedanceCurve
        Impedance over frequency by name of the estimator; empty if nothing could be estimated.
    trials : tuple of AssembledTrial
        Samples and their ledger, in the order of the perturbed joints; empty without bags.
    notes : tuple of str
        What could not be found or is unusual.
    """

    name: str
    summary: Summary
    curves: Mapping[str, ImpedanceCurve]
    trials: tuple[AssembledTrial, ...]
    notes: tuple[str, ...]

    @property
    def joint_names(self) -> list[str]:
        """Names of the n joints."""
        return self.summary.joint_names

    @property
    def averages(self) -> float | None:
        """Number of independent averages behind the coherences; None without curves."""
        known = [one.averages for name, one in self.curves.items() if name.startswith("welch")]
        return min(known or [one.averages for one in self.curves.values()], default=None)

    @property
    def significance(self) -> float | None:
        """Coherence below which signals count as unrelated; None without curves."""
        averages = self.averages
        return None if averages is None else coherence_significance(averages, _LIMITS.significance)


def load_result(
    directory: Path, bags: Sequence[Path] | None = None, *, namespace: str | None = None
) -> Result:
    """Read a result directory and the bags of its trials.

    What is missing besides the summary leaves a note, not an error.

    Parameters
    ----------
    directory : Path
        With ``summary.json`` and mostly ``frf.npz``.
    bags : sequence of Path, optional
        Where the trials are; by default where the summary says.
    namespace : str, optional
        Of the topics in the bags.

    Raises
    ------
    DataError
        If there is no readable summary.
    """
    summary = read_summary(directory / SUMMARY_FILE)
    notes: list[str] = []
    curves: dict[str, ImpedanceCurve] = {}
    if summary.estimators:
        try:
            curves = _fitting(read_frf(directory / FRF_FILE), summary)
        except DataError as error:
            notes.append(str(error))
    contents = []
    for path in _bags_of(directory, summary) if bags is None else dict.fromkeys(bags):
        try:
            # They have been read before, or were recorded here.
            contents.append(read_bag(path, namespace=namespace, trust=True))
        except (ArmimpError, OSError) as error:
            notes.append(f"no time traces: {error}")
    notes += (note for content in contents for note in content.notes)
    return Result(
        name=directory.absolute().name,
        summary=summary,
        curves=curves,
        trials=_trials(contents, summary, notes),
        notes=tuple(dict.fromkeys(notes)),
    )


def setting(config: Mapping[str, Any], *path: str) -> Any:
    """Look up a value in a configuration of any form; None if it is not there."""
    found: Any = config
    for key in path:
        if not isinstance(found, Mapping) or key not in found:
            return None
        found = found[key]
    return found


def _fitting(curves: Mapping[str, ImpedanceCurve], summary: Summary) -> dict[str, ImpedanceCurve]:
    n = summary.joints
    for name, curve in curves.items():
        shape = (n, n, curve.f.size)
        if curve.Z.shape != shape:
            raise DataError(f"{FRF_FILE}: {name} has shape {curve.Z.shape}, expected {shape}")
    return {name: curves[name] for name in summary.estimators if name in curves}


def _bags_of(directory: Path, summary: Summary) -> list[Path]:
    """Bags of a summary: paths are relative to its directory, or to where it was made."""
    names = dict.fromkeys(trial.bag for trial in summary.trials if trial.bag)
    inside = [(directory / name, Path(name)) for name in names]
    return [here if here.exists() else there for here, there in inside]


def _trials(
    contents: Sequence[BagContent], summary: Summary, notes: list[str]
) -> tuple[AssembledTrial, ...]:
    trials: list[AssembledTrial] = []
    for content in contents:
        if len(content.joint_names) == summary.joints:
            trials += content.trials
        else:
            count = len(content.joint_names)
            notes.append(f"{content.path}: has {count} joints, not {summary.joints}")
    return tuple(sorted(trials, key=lambda trial: (trial.window.joint, trial.trial)))
