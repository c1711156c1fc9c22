"""What a finished experiment left behind, for tests of the node graph."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np

from armimp_common.cdr import decode_trial_status, stamp_of
from armimp_common.status import TrialStatus
from armimp_common.topics import DATA_STREAMS, PERTURBATION, TRIAL
from armimp_estimation.bags import read_bag
from armimp_estimation.record import TrialRecord
from armimp_estimation.summary import Summary
from support.bag_files import iterate_messages
from support.synthetic_bags import assert_same


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordedTrial:
    """The messages of one trial in its bag."""

    streams: Mapping[str, list[bytes]]
    statuses: list[TrialStatus]

    @classmethod
    def read(cls, bag: Path) -> RecordedTrial:
        """Read a bag."""
        streams: dict[str, list[bytes]] = {topic: [] for topic in DATA_STREAMS}
        statuses: list[TrialStatus] = []
        for topic, _, raw in iterate_messages(bag):
            if topic == TRIAL:
                statuses.append(decode_trial_status(raw))
            elif topic in streams:
                streams[topic].append(raw)
        start_ns = statuses[-1].start_ns or 0
        first = sum(stamp_of(raw) < start_ns for raw in streams[PERTURBATION])
        part = slice(first, first + statuses[-1].ticks)
        return cls(streams={t: raws[part] for t, raws in streams.items()}, statuses=statuses)


@dataclass(frozen=True, kw_only=True, eq=False)
class FinishedRun:
    """An experiment that ran through the node graph."""

    directory: Path
    summary: Summary

    @property
    def bags(self) -> list[Path]:
        """Bags in the order of the trials."""
        return sorted((self.directory / "bags").iterdir())

    def records(self) -> list[TrialRecord]:
        """Samples of all trials, none of which may lack any."""
        found = [one.record for bag in self.bags for one in read_bag(bag).trials]
        return [record for record in found if record is not None]

    def trials(self) -> list[RecordedTrial]:
        """Read all bags."""
        return [RecordedTrial.read(bag) for bag in self.bags]

    def assert_same_streams(self, other: FinishedRun) -> None:
        """Check that every message of every data stream is the same to the last bit."""
        assert [bag.name for bag in self.bags] == [bag.name for bag in other.bags]
        for mine, others in zip(self.trials(), other.trials(), strict=True):
            for topic in DATA_STREAMS:
                assert mine.streams[topic] == others.streams[topic], topic

    def assert_same_as_offline(self, trials: list[TrialRecord]) -> None:
        """Check that the samples are those of the loop without ROS, to the last bit."""
        for mine, offline in zip(self.records(), trials, strict=True):
            assert_same(mine, offline)
            np.testing.assert_array_equal(mine.command, offline.command)


Run: TypeAlias = Callable[..., FinishedRun]
"""Runs a short experiment with options of `armimp_bringup.config.ExperimentConfig`."""
