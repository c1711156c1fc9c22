"""How long an estimate takes: from the bag of a trial to the result of the default estimators."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

from armimp_bringup.bench import Measured
from armimp_bringup.offline_estimate import estimate_bags
from armimp_common.cdr import decode_trial_status
from armimp_common.topics import TRIAL as TRIAL_TOPIC
from armimp_estimation.bags.reader import read_bag
from armimp_estimation.bags.writer import BagWriter
from armimp_estimation.metadata import Metadata
from armimp_estimation.parameters import EstimatorParameters
from armimp_estimation.result import conclude
from benchmarks.shortest import shortest
from support.synthetic_bags import recorded_arm

TARGET = 0.2
"""Longest time for a trial of 50 s, s."""
SAMPLES = 50_000
_REPEATS = 5


def time_estimate(tell: Callable[[str], None]) -> list[Measured]:
    """Time reading and estimating bags of a synthetic arm with two joints; shortest of several.

    Parameters
    ----------
    tell : callable
        Is told what is being measured.
    """
    names = EstimatorParameters().estimators
    with tempfile.TemporaryDirectory() as directory:
        tell(f"writing bags of {SAMPLES / 1000:g} s")
        bags = _write_bags(Path(directory))
        tell("reading bags and estimating")
        reading = shortest(lambda: read_bag(bags[0]), _REPEATS)
        whole = shortest(lambda: estimate_bags(bags, names), _REPEATS) / len(bags)
        contents = [read_bag(bag) for bag in bags]
    trials = [content.trials[0] for content in contents]

    def estimate(estimators: Sequence[str]) -> float:
        joints = contents[0].joint_names
        return shortest(
            lambda: conclude(trials, known=Metadata(), joint_names=joints, estimators=estimators),
            _REPEATS,
        ) / len(joints)

    length = f"trial of {SAMPLES / 1000:g} s"
    return [
        Measured(label=f"reading the bag of a {length}", value=reading, unit="s"),
        *(
            Measured(label=f"{name} alone, each {length}", value=estimate((name,)), unit="s")
            for name in names
        ),
        Measured(
            label=f"from bag to result ({', '.join(names)}), each {length}",
            value=whole,
            unit="s",
            limit=TARGET,
        ),
    ]


def _write_bags(directory: Path) -> list[Path]:
    """One bag for each trial."""
    recording = recorded_arm(SAMPLES)
    bags = [directory / f"trial_{record.trial}" for record in recording.records]
    present = 0
    writer: BagWriter | None = None
    try:
        for topic, log_time_ns, raw in recording.messages:
            if topic == TRIAL_TOPIC and (number := decode_trial_status(raw).trial) != present:
                if writer is not None:
                    writer.close()
                present, writer = number, BagWriter(bags[number - 1], metadata={})
            if writer is not None:
                writer.write(topic, raw, log_time_ns)
    finally:
        if writer is not None:
            writer.close()
    return bags
