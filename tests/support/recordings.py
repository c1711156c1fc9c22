"""Recordings of given trials, for tests of whatever takes the messages of an experiment."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from armimp_common import topics
from armimp_common.cdr import CommandEncoder, JointStateEncoder
from armimp_common.status import Phase, TrialStatus
from armimp_common.topics import PERIOD_NS
from armimp_estimation.bags.statuses import encode_trial_status
from armimp_estimation.record import TrialRecord
from support.synthetic_bags import Message, SyntheticRecording
from support.synthetic_trials import TWO_JOINT_ARM, SyntheticConfig, synthetic_trial


def recording_of(
    records: Sequence[TrialRecord], *, settle: int = 60, rest: int = 60, start_ns: int = 0
) -> SyntheticRecording:
    """Return the messages which an experiment with these trials would have sent.

    Parameters
    ----------
    records : sequence of TrialRecord
        One for each trial, in order; numbers and stamps in them are given anew.
    settle, rest : int
        Control periods before and after the perturbation of each trial, without motion.
    start_ns : int
        Stamp of the first sample (ns).

    Returns
    -------
    SyntheticRecording
        Messages in the order of the graph, statuses included, with the stamp as log time; and
        the records with their new numbers and stamps.
    """
    names = records[0].joint_names
    states, efforts = JointStateEncoder(names, "position"), JointStateEncoder(names, "effort")
    commands = CommandEncoder(len(names))
    messages: list[Message] = []
    renumbered: list[TrialRecord] = []
    tick = 0

    def announce(phase: Phase, number: int) -> None:
        record = records[number - 1]
        status = TrialStatus(
            phase=phase,
            trial=number,
            trials=len(records),
            joint=record.perturbed_joint,
            joint_name=names[record.perturbed_joint],
            tick=tick,
            start_ns=None if phase is Phase.SETTLE else renumbered[-1].start_ns,
            ticks=record.samples,
            seed=record.seed or 0,
            valid=True,
        )
        messages.append((topics.TRIAL, start_ns + tick * PERIOD_NS, encode_trial_status(status)))

    for number, record in enumerate(records, 1):
        first = tick + settle
        renumbered.append(replace(record, trial=number, start_ns=start_ns + first * PERIOD_NS))
        padding = ((0, 0), (settle, rest))
        position = np.pad(record.position, padding, mode="edge")
        torque = np.pad(record.torque, padding)
        perturbation = np.pad(record.perturbation, padding)
        phases = {0: Phase.SETTLE, settle: Phase.PERTURB, settle + record.samples: Phase.REST}
        for k in range(position.shape[1]):
            stamp_ns = start_ns + tick * PERIOD_NS
            messages += [
                (topics.JOINT_STATES, stamp_ns, states.encode(stamp_ns, position[:, k])),
                (topics.TORQUE_SENSORS, stamp_ns, efforts.encode(stamp_ns, torque[:, k])),
            ]
            if k in phases:
                announce(phases[k], number)
            messages += [
                (topics.COMMANDS, stamp_ns, commands.encode(perturbation[:, k])),
                (topics.PERTURBATION, stamp_ns, efforts.encode(stamp_ns, perturbation[:, k])),
            ]
            tick += 1
    announce(Phase.DONE, len(records))
    return SyntheticRecording(messages=tuple(messages), records=tuple(renumbered))


@functools.cache
def recorded_arm(samples: int = 10_000) -> SyntheticRecording:
    """Return the recording of a whole experiment on `synthetic.TWO_JOINT_ARM`.

    Parameters
    ----------
    samples : int
        Perturbed samples of each of its two trials.
    """
    config = SyntheticConfig(samples=samples)
    return recording_of([synthetic_trial(TWO_JOINT_ARM, k, config, seed=1) for k in range(2)])
