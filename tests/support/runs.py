"""What a finished experiment left behind, for tests of the node graph."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from armimp_common.cdr import CommandDecoder, JointStateDecoder, decode_trial_status, stamp_of
from armimp_common.status import TrialStatus
from armimp_common.topics import COMMANDS, DATA_STREAMS, PERIOD_NS, PERTURBATION, TRIAL, VALUE_FIELD
from armimp_estimation.bags import read_bag
from armimp_estimation.record import TrialRecord
from armimp_estimation.summary import Summary
from support.bag_files import iterate_messages


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

    def values(self, topic: str, names: tuple[str, ...]) -> NDArray[np.float64]:
        """Numbers (n, N) of a data stream, rad or N·m."""
        if topic == COMMANDS:
            return CommandDecoder(len(names)).decode_many(self.streams[topic])[1]
        return JointStateDecoder(names, VALUE_FIELD[topic]).decode_many(self.streams[topic])[1]

    def stamps(self, topic: str, names: tuple[str, ...]) -> NDArray[np.int64]:
        """Stamps (N,) of a data stream that has some, ns."""
        decoder = JointStateDecoder(names, VALUE_FIELD[topic])
        return decoder.decode_many(self.streams[topic])[0]


@dataclass(frozen=True, kw_only=True, eq=False)
class FinishedRun:
    """An experiment that ran through the node graph."""

    directory: Path
    summary: Summary

    @property
    def bags(self) -> list[Path]:
        """Bags in the order of the trials."""
        return sorted((self.directory / "bags").iterdir())

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints, from the first bag."""
        return read_bag(self.bags[0]).joint_names

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
        names = self.joint_names
        for mine, offline in zip(self.trials(), trials, strict=True):
            stamps = offline.start_ns + PERIOD_NS * np.arange(offline.position.shape[1])
            for topic in VALUE_FIELD:
                np.testing.assert_array_equal(mine.stamps(topic, names), stamps)
            expected = (offline.position, offline.torque, offline.command, offline.perturbation)
            for topic, values in zip(DATA_STREAMS, expected, strict=True):
                np.testing.assert_array_equal(mine.values(topic, names), values, err_msg=topic)


class Run(Protocol):
    """Runs a short experiment with these options of `armimp_bringup.config.ExperimentConfig`."""

    def __call__(self, **options: Any) -> FinishedRun:
        """Run it."""


# MISSING
