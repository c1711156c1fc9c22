"""What a report is made of: the files of a result directory and the bags behind them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from armimp_common.errors import ArmimpError, DataError
from armimp_estimation.assemble import AssembledTrial
from armimp_estimation.bags import BagContent, read_bag
from armimp_estimation.conclusion import FRF_FILE, SUMMARY_FILE
from armimp_estimation.gaps import segments_for
from armimp_estimation.results import ImpedanceCurve, Summary, read_frf, read_summary
from armimp_estimation.scores import coherence_significance
from armimp_estimation.trial import TrialData, TrialSpectra
from armimp_estimation.verdict import Limits

_LIMITS = Limits()


@dataclass(frozen=True, kw_only=True, eq=False)
class TrialEvidence:
    """What the bag of a trial tells beyond the summary.

    Attributes
    ----------
    assembled : AssembledTrial
        Samples and their ledger.
    spectra : TrialSpectra or None
        If the trial has a record that is long enough.
    """

    assembled: AssembledTrial
    spectra: TrialSpectra | None

    @property
    def joint(self) -> int:
        """The perturbed joint, 0-based."""
        return self.assembled.window.joint


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
    trials : tuple of TrialEvidence
        In the order of the perturbed joints; empty without bags.
    joint_names : tuple of str
        Names of the n joints.
    notes : tuple of str
        What could not be found or is unusual.
    """

    name: str
    summary: Summary
    curves: Mapping[str, ImpedanceCurve]
    trials: tuple[TrialEvidence, ...]
    joint_names: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def spectra(self) -> dict[int, TrialSpectra]:
        """Spectra by perturbed joint, 0-based."""
        return {trial.joint: trial.spectra for trial in self.trials if trial.spectra is not None}

    @property
    def averages(self) -> float | None:
        """Number of independent averages behind the spectra; None without spectra."""
        found = [one.spectra.effective_averages for one in self.spectra.values()]
        return min(found, default=None)

    @property
    def significance(self) -> float | None:
        """Coherence below which signals count as unrelated; None without spectra."""
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
    trials = _evidence(contents, summary, notes)
    return Result(
        name=directory.absolute().name,
        summary=summary,
        curves=curves,
        trials=trials,
        joint_names=_joint_names(summary, contents),
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
        if curve.Z.shape != shape or curve.variance.shape != shape or not curve.f.size:
            raise DataError(f"{FRF_FILE}: {name} has shape {curve.Z.shape}, expected {shape}")
    return {name: curves[name] for name in summary.estimators if name in curves}


def _bags_of(directory: Path, summary: Summary) -> list[Path]:
    """Bags of a summary: paths are relative to its directory, or to where it was made."""
    names = dict.fromkeys(trial.bag for trial in summary.trials if trial.bag)
    inside = [(directory / name, Path(name)) for name in names]
    return [here if here.exists() else there for here, there in inside]


def _evidence(
    contents: Sequence[BagContent], summary: Summary, notes: list[str]
) -> tuple[TrialEvidence, ...]:
    trials: list[AssembledTrial] = []
    for content in contents:
        if len(content.joint_names) == summary.joints:
            trials += content.trials
        else:
            count = len(content.joint_names)
            notes.append(f"{content.path}: has {count} joints, not {summary.joints}")
    # The same segments as the estimate had, which may have used the intact parts only.
    used = [
        trial
        for trial in trials
        if trial.record is not None or (summary.estimators and trial.segments)
    ]
    welch = segments_for([trial.segments for trial in used])
    known = summary.torque_reading
    reading = None if known is None else known.reading()
    found = []
    for trial in sorted(trials, key=lambda trial: (trial.window.joint, trial.trial)):
        spectra = None
        if trial in used:
            try:
                spectra = TrialData.from_stretches(trial.segments, welch, reading).spectra
            except DataError as error:
                notes.append(str(error))
        found.append(TrialEvidence(assembled=trial, spectra=spectra))
    return tuple(found)


def _joint_names(summary: Summary, contents: Sequence[BagContent]) -> tuple[str, ...]:
    for content in contents:
        if len(content.joint_names) == summary.joints:
            return content.joint_names
    for node in ("imbic_controller", "arm_sim"):
        names = setting(summary.config, node, "joints")
        if isinstance(names, list) and len(names) == summary.joints:
            return tuple(map(str, names))
    return tuple(f"joint {i + 1}" for i in range(summary.joints))
