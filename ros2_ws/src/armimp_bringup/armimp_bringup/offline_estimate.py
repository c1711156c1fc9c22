"""Estimates from bags, without a node graph."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from armimp_bringup.config import Declared
from armimp_common.errors import DataError
from armimp_estimation.bags.reader import BagContent, find_bags, read_bag
from armimp_estimation.bags.writer import finish_bag
from armimp_estimation.estimators.estimate import Estimator
from armimp_estimation.metadata import Metadata, latest_metadata
from armimp_estimation.parameters import EstimatorParameters
from armimp_estimation.result import Result, conclude
from armimp_estimation.torque_timing import TorqueTiming

_TIMINGS = {
    "before": TorqueTiming.BEFORE_UPDATE,
    "after": TorqueTiming.AFTER_UPDATE,
    "mid": TorqueTiming.MID_INTERVAL,
    "mean": TorqueTiming.INTERVAL_MEAN,
    "simultaneous": TorqueTiming.SIMULTANEOUS,
}


def estimate_bags(
    bags: Sequence[Path],
    estimators: Sequence[str | Estimator],
    *,
    namespace: str | None = None,
    allow_gaps: bool = False,
    declared: Declared | None = None,
) -> Result:
    """Identify the impedance from bags that hold one trial for each joint between them.

    Parameters
    ----------
    bags : any bags that the reader takes, or directories of runs
    estimators : names, or `Estimator` objects; empty for the defaults
    namespace : namespace of the topics
    allow_gaps : use the intact parts of trials that lost samples
    declared : overrides what the bags say

    Returns
    -------
    Result
        With notes on what a user should know about the bags.

    Raises
    ------
    BagError
        If a bag can't be read.
    DataError
        If the bags don't belong together, or a trial can't be estimated.
    """
    contents, metadata = read_bags(bags, namespace=namespace, allow_gaps=allow_gaps)
    joint_names = contents[0].joint_names
    values = (declared or Declared()).model_dump(by_alias=True, exclude_none=True)
    if "torque_timing" in values:
        values["torque_timing"] = _TIMINGS[values["torque_timing"]].value
    metadata |= {key: json.dumps(value) for key, value in values.items()}
    result = conclude(
        [trial for content in contents for trial in content.trials],
        known=Metadata.of(metadata, len(joint_names)),
        joint_names=joint_names,
        estimators=estimators or EstimatorParameters().estimators,
    )
    return replace(result, notes=tuple(note for content in contents for note in content.notes))


def read_bags(
    bags: Sequence[Path], *, namespace: str | None = None, allow_gaps: bool = False
) -> tuple[list[BagContent], dict[str, str]]:
    """Read bags that belong to one experiment, and the metadata that count for all of them.

    Bags that a killed recorder left are completed. `bags` is as for
    :func:`armimp_estimation.bags.reader.find_bags`. Raises a BagError if a bag can't be read, or is
    given twice; a DataError if the joints differ between them, the metadata make no sense, or a
    trial is refused, as one that lost samples is without `allow_gaps`.
    """
    contents = []
    for path in find_bags(bags):
        finished = finish_bag(path)
        content = read_bag(path, namespace=namespace)
        trials = tuple(replace(trial, allow_gaps=allow_gaps) for trial in content.trials)
        notes = (finished, *content.notes) if finished else content.notes
        contents.append(replace(content, trials=trials, notes=notes))
    for content in contents[1:]:
        if content.joint_names != contents[0].joint_names:
            raise DataError(
                f"{content.path}: joints {', '.join(content.joint_names)} differ from "
                f"{', '.join(contents[0].joint_names)} of {contents[0].path}"
            )
    try:
        for content in contents:
            Metadata.of(content.metadata, len(content.joint_names))
    except DataError as error:
        raise DataError(f"{content.path}: {error}") from None
    for content in contents:
        for trial in content.trials:
            trial.intact()
    return contents, latest_metadata([content.metadata for content in contents])
