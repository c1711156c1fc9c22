"""Estimates from bags, without a node graph."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from armimp_common.errors import DataError
from armimp_estimation.bags import BagContent, read_bag
from armimp_estimation.conclusion import Conclusion, FinishedTrial, conclude
from armimp_estimation.parameters import EstimatorParameters


def estimate_bags(
    bags: Sequence[Path], estimators: tuple[str, ...], *, namespace: str | None = None
) -> tuple[Conclusion, list[str]]:
    """Identify the impedance from bags that hold one trial for each joint between them.

    Parameters
    ----------
    bags : sequence of Path
        Any bags that the reader takes.
    estimators : tuple of str
        Names; empty for the defaults.
    namespace : str, optional
        Namespace of the topics.

    Returns
    -------
    conclusion : Conclusion
    notes : list of str
        What a user should know of the bags.

    Raises
    ------
    BagError
        If a bag can't be read.
    DataError
        If the bags don't belong together, or a trial can't be estimated.
    """
    contents = read_bags(bags, namespace=namespace)
    names = contents[0].joint_names
    notes = [f"{content.path}: {note}" for content in contents for note in content.notes]
    trials: list[FinishedTrial] = []
    for content in contents:
        for trial in content.trials:
            trial.require()
            notes += [f"{content.path}: {trial.note}"] if trial.note else []
            trials.append(FinishedTrial(assembled=trial, bag=str(content.path)))
    conclusion = conclude(
        trials,
        metadata=contents[0].metadata,
        joints=len(names),
        estimators=estimators or EstimatorParameters().estimators,
    )
    return conclusion, notes


def read_bags(bags: Sequence[Path], *, namespace: str | None = None) -> list[BagContent]:
    """Read bags which belong to one experiment.

    Raises
    ------
    BagError
        If a bag can't be read.
    DataError
        If the joints differ between them.
    """
    contents = [read_bag(path, namespace=namespace) for path in bags]
    for content in contents[1:]:
        if content.joint_names != contents[0].joint_names:
            raise DataError(
                f"{content.path}: joints {', '.join(content.joint_names)} differ from "
                f"{', '.join(contents[0].joint_names)} of {contents[0].path}"
            )
    return contents
