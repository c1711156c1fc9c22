"""Estimates from bags, without a node graph."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from armimp_common.errors import DataError
from armimp_estimation.bags import BagContent, read_bag
from armimp_estimation.bags.finishing import finish_bag
from armimp_estimation.conclusion import Conclusion, FinishedTrial, conclude, understand
from armimp_estimation.estimate import Estimator
from armimp_estimation.gaps import GapConfig
from armimp_estimation.parameters import EstimatorParameters
from armimp_estimation.timing import latest_metadata


def estimate_bags(
    bags: Sequence[Path],
    estimators: Sequence[str | Estimator],
    *,
    namespace: str | None = None,
    allow_gaps: bool = False,
    torque_delay: float | None = None,
    trust: bool = False,
) -> tuple[Conclusion, list[str]]:
    """Identify the impedance from bags that hold one trial for each joint between them.

    Parameters
    ----------
    bags : sequence of Path
        Any bags that the reader takes.
    estimators : sequence of str or Estimator
        Names, or estimators of one's own; empty for the defaults.
    namespace : str, optional
        Namespace of the topics.
    allow_gaps : bool
        Use the intact parts of trials that lost samples.
    torque_delay : float, optional
        How late torque readings are, s, in the place of what the bags say.
    trust : bool
        Whether to lift the limits on what a bag may hold, which grow with its size.

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
    contents = read_bags(bags, namespace=namespace, trust=trust)
    names = contents[0].joint_names
    notes = [note for content in contents for note in content.notes]
    trials: list[FinishedTrial] = []
    for content in contents:
        for trial in content.trials:
            trial.intact(allow_gaps=allow_gaps)
            trials.append(FinishedTrial(assembled=trial, bag=str(content.path)))
    metadata = latest_metadata([content.metadata for content in contents])
    if torque_delay is not None:
        metadata["torque_delay"] = json.dumps(torque_delay)
    conclusion = conclude(
        trials,
        metadata=metadata,
        joint_names=names,
        estimators=estimators or EstimatorParameters().estimators,
        gaps=GapConfig(allow=allow_gaps),
    )
    return conclusion, notes


def read_bags(
    bags: Sequence[Path], *, namespace: str | None = None, trust: bool = False
) -> list[BagContent]:
    """Read bags which belong to one experiment; those that a killed recorder left are finished.

    Raises
    ------
    BagError
        If a bag can't be read.
    DataError
        If the joints differ between them, or the metadata make no sense.
    """
    contents = []
    for path in bags:
        finished = finish_bag(path, trust=trust)
        content = read_bag(path, namespace=namespace, trust=trust)
        contents.append(replace(content, notes=(finished, *content.notes)) if finished else content)
    for content in contents[1:]:
        if content.joint_names != contents[0].joint_names:
            raise DataError(
                f"{content.path}: joints {', '.join(content.joint_names)} differ from "
                f"{', '.join(contents[0].joint_names)} of {contents[0].path}"
            )
    try:
        for content in contents:
            understand(content.metadata, len(content.joint_names))
    except DataError as error:
        raise DataError(f"{content.path}: {error}") from None
    return contents
