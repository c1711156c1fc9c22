"""Recordings of given and of made-up trials, for tests of what reads messages or bags."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from armimp_common.cdr import CommandEncoder, JointStateEncoder, encode_trial_status
from armimp_common.status import Phase, TrialStatus
from armimp_common.topics import (
    COMMANDS,
    JOINT_STATES,
    PERIOD_NS,
    PERTURBATION,
    TORQUE_SENSORS,
    TRIAL,
)
from armimp_estimation.record import TrialRecord
from support.synthetic_trials import TWO_JOINT_ARM, SyntheticConfig, made_record, synthetic_trial

Message: TypeAlias = tuple[str, int, bytes]
"""Topic of the contract, log time (ns) and serialised message."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SyntheticRecording:
    """Messages, and the records which they must give."""

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
    """Make up the recording of consecutive trials, whose end is not announced.

    The numbers have no physical meaning: a random walk as position, noise as torque.
    """
    names = tuple(joint_names)
    rng = np.random.default_rng(seed)
    records = []
    for joint in perturbed:
        torque = rng.normal(size=(len(names), ticks))
        perturbation = np.zeros(torque.shape)
        perturbation[joint] = rng.uniform(0.1, 1.0, ticks)
        position = np.cumsum(rng.normal(scale=1e-3, size=torque.shape), axis=1)
        told = {"perturbed_joint": joint, "joint_names": names}
        command = torque + perturbation
        records.append(made_record(position, torque, perturbation, command=command, **told))
    made = recording_of(records, settle=settle, rest=rest, start_ns=start_ns)
    return replace(made, messages=made.messages[:-1])  # without the end


def recording_of(
    records: Sequence[TrialRecord], *, settle: int = 60, rest: int = 60, start_ns: int = 0
) -> SyntheticRecording:
    """Return the messages which an experiment with these trials would have sent."""
    names = records[0].joint_names
    states, efforts = JointStateEncoder(names, "position"), JointStateEncoder(names, "effort")
    commands = CommandEncoder(len(names))
    messages: list[Message] = []
    renumbered: list[TrialRecord] = []
    stamp = start_ns

    def announce(phase: Phase) -> None:
        record = renumbered[-1]
        status = TrialStatus(
            phase=phase,
            trial=record.trial,
            trials=len(records),
            joint=record.perturbed_joint,
            joint_name=names[record.perturbed_joint],
            tick=(stamp - start_ns) // PERIOD_NS,
            start_ns=None if phase is Phase.SETTLE else record.start_ns,
            ticks=record.samples,
            seed=1,
            valid=True,
        )
        messages.append((TRIAL, stamp, encode_trial_status(status)))

    for number, given in enumerate(records, 1):
        renumbered.append(replace(given, trial=number, start_ns=stamp + settle * PERIOD_NS))
        command = given.perturbation if given.command is None else given.command
        padding = ((0, 0), (settle, rest))
        position = np.pad(given.position, padding, mode="edge")
        torque, perturbation, command = (
            np.pad(one, padding) for one in (given.torque, given.perturbation, command)
        )
        begins = {Phase.SETTLE: 0, Phase.PERTURB: settle, Phase.REST: settle + given.samples}
        for tick in range(position.shape[1] + 1):
            for phase, first in begins.items():
                if tick == first:
                    announce(phase)
            if tick == position.shape[1]:
                break
            raws = {
                JOINT_STATES: states.encode(stamp, position[:, tick]),
                TORQUE_SENSORS: efforts.encode(stamp, torque[:, tick]),
                COMMANDS: commands.encode(command[:, tick]),
                PERTURBATION: efforts.encode(stamp, perturbation[:, tick]),
            }
            messages += [(topic, stamp, raw) for topic, raw in raws.items()]
            stamp += PERIOD_NS
    announce(Phase.DONE)
    return SyntheticRecording(messages=tuple(messages), records=tuple(renumbered))


@functools.cache
def recorded_arm(samples: int = 10_000) -> SyntheticRecording:
    """Return the recording of two trials on `TWO_JOINT_ARM`, each of so many samples."""
    config = SyntheticConfig(samples=samples)
    return recording_of([synthetic_trial(TWO_JOINT_ARM, k, config, seed=1) for k in range(2)])


def assert_same(
    record: TrialRecord, expected: TrialRecord, start: int = 0, stop: int | None = None
) -> None:
    """Check that a record holds these samples of another one, without what only a node knows."""
    for name in ("position", "torque", "perturbation"):
        values = getattr(record, name)
        assert values.flags.c_contiguous
        np.testing.assert_array_equal(values, getattr(expected, name)[:, start:stop])
    assert record.start_ns == expected.start_ns + start * PERIOD_NS
    for name in ("perturbed_joint", "joint_names", "rate", "trial"):
        assert getattr(record, name) == getattr(expected, name)
