"""Made-up recordings, for tests and demonstrations of whatever takes a bag.

The numbers have no physical meaning: a random walk as position, noise as torque.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from armimp_common.cdr import CommandEncoder, JointStateEncoder
from armimp_common.status import Phase, TrialStatus
from armimp_common.topics import (
    COMMANDS,
    JOINT_STATES,
    NS_PER_S,
    PERIOD_NS,
    PERTURBATION,
    TORQUE_SENSORS,
    TRIAL,
)
from armimp_estimation.bags.statuses import encode_trial_status
from armimp_estimation.record import TrialRecord

Message: TypeAlias = tuple[str, int, bytes]
"""Topic of the contract, log time (ns) and serialised message."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SyntheticRecording:
    """Messages, and the records which they must give.

    Parameters
    ----------
    messages : tuple of Message
        In recorded order.
    records : tuple of TrialRecord
        One for each trial.
    """

    messages: tuple[Message, ...]
    records: tuple[TrialRecord, ...]

    def by_topic(self) -> dict[str, list[bytes]]:
        """Serialised messages of each topic."""
        topics: dict[str, list[bytes]] = {}
        for topic, _, raw in self.messages:
            topics.setdefault(topic, []).append(raw)
        return topics


def synthetic_recording(
    *,
    joint_names: Sequence[str] = ("shoulder", "elbow"),
    perturbed: Sequence[int] = (0,),
    ticks: int = 100,
    settle: int = 0,
    rest: int = 0,
    start_ns: int = 1_000_000_000,
    seed: int = 1,
) -> SyntheticRecording:
    """Make up the recording of some trials, one after the other.

    Parameters
    ----------
    joint_names : sequence of str
        The n joints.
    perturbed : sequence of int
        Perturbed joint of each trial, 0-based.
    ticks : int
        Perturbed samples of each trial.
    settle, rest : int
        Control periods before and after the perturbation of each trial.
    start_ns : int
        Stamp of the first sample (ns).
    seed : int
        Of the numbers, and as seed of the experiment.
    """
    names = tuple(joint_names)
    length = (settle + ticks + rest) * len(perturbed)
    rng = np.random.default_rng(seed)
    shape = (len(names), length)
    position = np.cumsum(rng.normal(scale=1e-3, size=shape), axis=1)
    torque = rng.normal(size=shape)
    perturbation = np.zeros(shape)
    records: list[TrialRecord] = []
    statuses: list[tuple[int, TrialStatus]] = []
    for index, joint in enumerate(perturbed):
        first = index * (settle + ticks + rest) + settle
        part = slice(first, first + ticks)
        perturbation[joint, part] = rng.uniform(0.1, 1.0, ticks)
        first_ns = start_ns + first * PERIOD_NS
        records.append(
            TrialRecord(
                trial=index + 1,
                perturbed_joint=joint,
                rate=NS_PER_S / PERIOD_NS,
                joint_names=names,
                perturbation=perturbation[:, part],
                position=position[:, part],
                torque=torque[:, part],
                start_ns=first_ns,
                seed=seed,
            )
        )
        for phase, tick in (
            (Phase.SETTLE, first - settle),
            (Phase.PERTURB, first),
            (Phase.REST, first + ticks),
        ):
            status = TrialStatus(
                phase=phase,
                trial=index + 1,
                trials=len(perturbed),
                joint=joint,
                joint_name=names[joint],
                tick=tick,
                start_ns=None if phase is Phase.SETTLE else first_ns,
                ticks=ticks,
                seed=seed,
                valid=True,
            )
            statuses.append((tick, status))
    samples = _samples(names, start_ns, position, torque, perturbation)
    return SyntheticRecording(
        messages=tuple(_interleaved(samples, statuses, start_ns, length)),
        records=tuple(records),
    )


def _samples(
    names: Sequence[str],
    start_ns: int,
    position: NDArray[np.float64],
    torque: NDArray[np.float64],
    perturbation: NDArray[np.float64],
) -> list[list[Message]]:
    """Messages of each control period, in the order in which the graph sends them."""
    states = JointStateEncoder(names, "position")
    efforts = JointStateEncoder(names, "effort")
    commands = CommandEncoder(len(names))
    periods: list[list[Message]] = []
    for tick in range(position.shape[1]):
        stamp = start_ns + tick * PERIOD_NS
        raws = {
            JOINT_STATES: states.encode(stamp, position[:, tick]),
            TORQUE_SENSORS: efforts.encode(stamp, torque[:, tick]),
            COMMANDS: commands.encode(torque[:, tick] + perturbation[:, tick]),
            PERTURBATION: efforts.encode(stamp, perturbation[:, tick]),
        }
        periods.append(
            [(topic, stamp + 10_000 * (1 + i), raw) for i, (topic, raw) in enumerate(raws.items())]
        )
    return periods


def _interleaved(
    samples: list[list[Message]],
    statuses: Sequence[tuple[int, TrialStatus]],
    start_ns: int,
    length: int,
) -> Iterator[Message]:
    for tick in range(length + 1):
        for when, status in statuses:
            if when == tick:
                log_time = start_ns + tick * PERIOD_NS
                yield TRIAL, log_time, encode_trial_status(status)
        if tick < length:
            yield from samples[tick]


def assert_same(record: TrialRecord, expected: TrialRecord) -> None:
    """Check that a record holds the samples of another one, without what only a node knows."""
    for name in ("position", "torque", "perturbation"):
        values = getattr(record, name)
        assert values.flags.c_contiguous
        np.testing.assert_array_equal(values, getattr(expected, name))
    for name in ("start_ns", "perturbed_joint", "joint_names", "rate", "trial"):
        assert getattr(record, name) == getattr(expected, name)
