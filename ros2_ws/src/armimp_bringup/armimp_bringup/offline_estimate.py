"""Estimates from bags, without a node graph."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from armimp_common.errors import ConfigurationError, DataError
from armimp_estimation.alignment.gaps import GapConfig
from armimp_estimation.bags import BagContent, read_bag
from armimp_estimation.bags.finishing import finish_bag
from armimp_estimation.bags.storage import require_distinct
from armimp_estimation.conclusion import (
    RATE_KEY,
    TIMING_KEY,
    UNCERTAINTY_KEY,
    Conclusion,
    FinishedTrial,
    conclude,
    understand,
)
from armimp_estimation.estimators.estimate import Estimator
from armimp_estimation.parameters import EstimatorParameters
from armimp_estimation.realtime_timing import latest_metadata
from armimp_estimation.sampling import HIGHEST, LOWEST
from armimp_estimation.torque_timing import TorqueTiming

_LATEST = 0.1
_TIMINGS = {
    "before": TorqueTiming.BEFORE_UPDATE,
    "after": TorqueTiming.AFTER_UPDATE,
    "mid": TorqueTiming.MID_INTERVAL,
    "mean": TorqueTiming.INTERVAL_MEAN,
    "simultaneous": TorqueTiming.SIMULTANEOUS,
}


@dataclass(frozen=True, kw_only=True)
class Declared:
    """What a user tells of a recording, in the place of what the bags say; None: nothing.

    Parameters
    ----------
    torque_timing : str or None
        When torques are read: before, after, mid, mean or simultaneous.
    torque_delay : float or None
        How late they are beyond that, s; negative if they are early.
    torque_uncertainty : float or None
        Standard error of these two, s.
    rate : float or None
        Sampling rate, Hz.

    Raises
    ------
    ConfigurationError
        If a value is out of range.
    """

    torque_timing: str | None = None
    torque_delay: float | None = None
    torque_uncertainty: float | None = None
    rate: float | None = None

    def __post_init__(self) -> None:
        if self.torque_timing is not None and self.torque_timing not in _TIMINGS:
            known = ", ".join(_TIMINGS)
            raise ConfigurationError(f"--torque-timing: {self.torque_timing!r} is none of {known}")
        if self.torque_delay is not None and not abs(self.torque_delay) <= _LATEST:
            raise ConfigurationError(
                f"--torque-delay: {self.torque_delay} is not within ± {_LATEST:g} s"
            )
        if self.torque_uncertainty is not None and not 0 <= self.torque_uncertainty <= _LATEST:
            raise ConfigurationError(
                f"--torque-uncertainty: {self.torque_uncertainty} is not within 0 to {_LATEST:g} s"
            )
        if self.rate is not None and not LOWEST <= self.rate <= HIGHEST:
            raise ConfigurationError(
                f"--rate: {self.rate} is not within {LOWEST:g} to {HIGHEST:g} Hz"
            )

    @property
    def metadata(self) -> dict[str, str]:
        """The same as metadata of a bag."""
        timing = None if self.torque_timing is None else _TIMINGS[self.torque_timing].value
        told = {
            TIMING_KEY: timing,
            "torque_delay": self.torque_delay,
            UNCERTAINTY_KEY: self.torque_uncertainty,
            RATE_KEY: self.rate,
        }
        return {key: json.dumps(value) for key, value in told.items() if value is not None}


def estimate_bags(
    bags: Sequence[Path],
    estimators: Sequence[str | Estimator],
    *,
    namespace: str | None = None,
    allow_gaps: bool = False,
    declared: Declared | None = None,
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
    declared : Declared, optional
        What is known in the place of what the bags say.
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
    metadata |= (declared or Declared()).metadata
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
        If a bag can't be read, or is given twice.
    DataError
        If the joints differ between them, or the metadata make no sense.
    """
    require_distinct(bags)
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
