"""What a finished experiment left behind, for tests of the node graph."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np

from armimp_common.cdr import decode_trial_status, stamp_of
from armimp_common.topics import COMMANDS, DATA_STREAMS, PERTURBATION, TRIAL
from armimp_estimation.bags.reader import read_bag
from armimp_estimation.record import TrialRecord
from armimp_estimation.summary import Summary
from support.bag_files import iterate_messages
from support.synthetic_bags import assert_same


def streams_of(bag: Path) -> dict[str, list[bytes]]:
    """The messages of the trial in a bag, by their stream."""
    streams: dict[str, list[bytes]] = {}
    for topic, _, raw in iterate_messages(bag):
        streams.setdefault(topic, []).append(raw)
    status = decode_trial_status(streams[TRIAL][-1])
    # A bag may begin between two messages of a sample; commands come with the perturbation.
    stamped, start = {**streams, COMMANDS: streams[PERTURBATION]}, status.start_ns or 0
    first = {one: sum(stamp_of(raw) < start for raw in stamped[one]) for one in DATA_STREAMS}
    return {one: streams[one][first[one] : first[one] + status.ticks] for one in DATA_STREAMS}


@dataclass(frozen=True, kw_only=True, eq=False)
class FinishedRun:
    """An experiment that ran through the node graph."""

    directory: Path
    summary: Summary

    @property
    def bags(self) -> list[Path]:
        """Bags in the order of the trials."""
        return sorted((self.directory / "bags").iterdir())

    def assert_same_streams(self, other: "FinishedRun") -> None:
        """Check that every message of every data stream is the same to the last bit."""
        assert [bag.name for bag in self.bags] == [bag.name for bag in other.bags]
        for bags in zip(self.bags, other.bags, strict=True):
            mine, others = map(streams_of, bags)
            assert [topic for topic in mine if mine[topic] != others[topic]] == []

    def assert_same_as_offline(self, trials: list[TrialRecord]) -> None:
        """Check that the samples are those of the loop without ROS, to the last bit."""
        found = [one.record for bag in self.bags for one in read_bag(bag).trials]
        for mine, offline in zip(found, trials, strict=True):
            assert mine is not None, "it lacks samples"
            assert_same(mine, offline)
            np.testing.assert_array_equal(mine.command, offline.command)


Run: TypeAlias = Callable[..., FinishedRun]
"""Runs a short experiment with options of `armimp_bringup.config.ExperimentConfig`."""
