"""What a tick of an experiment costs without ROS, part by part."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter_ns

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.parameters import node_parameters
from armimp_common.cdr import CommandDecoder, CommandEncoder, JointStateDecoder, JointStateEncoder
from armimp_common.errors import DataError
from armimp_common.status import Phase, TrialStatus
from armimp_common.topics import (
    COMMANDS,
    JOINT_STATES,
    NS_PER_S,
    PERTURBATION,
    TORQUE_SENSORS,
    VALUE_FIELD,
)
from armimp_control.trial_sequencer import TrialSequencer
from armimp_estimation.alignment.synchronizer import TOGETHER
from armimp_estimation.recorder import TrialRecorder
from armimp_sim.simulator import SimulatedRig
from support.streams import fed_synchronizer


@dataclass(frozen=True, kw_only=True)
class TickParts:
    """Wall time of each part of a tick, s."""

    plant: float
    """Simulated step of the rig."""
    law: float
    """Control law and safety limiter."""
    codecs: float
    """Encoding and decoding of the messages."""
    recording: float
    """Of the messages, into a bag."""


class _Loop:
    """Rig, controller and recorder, which pass the bytes of their messages to one another."""

    def __init__(self, config: ExperimentConfig, directory: Path) -> None:
        parameters = node_parameters(config, directory)
        names = parameters.simulator.joints
        self.rig = SimulatedRig(parameters.simulator)
        self.statuses: list[TrialStatus] = []
        self.experiment = TrialSequencer(parameters.controller, self.statuses.append)
        self.synchronizer, self.receivers = fed_synchronizer()
        self.recording = TrialRecorder(parameters.estimator, lambda *_: None)
        self.encoders = {
            topic: JointStateEncoder(names, field) for topic, field in VALUE_FIELD.items()
        }
        self.decoders = {
            topic: JointStateDecoder(names, VALUE_FIELD[topic])
            for topic in (JOINT_STATES, TORQUE_SENSORS)
        }
        self.encode_command = CommandEncoder(len(names)).encode
        self.decode_command = CommandDecoder(len(names)).decode
        self.command = (0.0,) * len(names)

    def tick(self) -> tuple[int, int, int, int]:
        """Run one tick; return the times of plant, law, codecs and recording, ns."""
        rig, experiment = self.rig, self.experiment
        t0 = perf_counter_ns()
        rig.step(self.command)
        t1 = perf_counter_ns()
        position = self.encoders[JOINT_STATES].encode(rig.stamp_ns, rig.position)
        torque = self.encoders[TORQUE_SENSORS].encode(rig.stamp_ns, rig.torque)
        stamp_ns, theta = self.decoders[JOINT_STATES].decode(position)
        _, tau_h = self.decoders[TORQUE_SENSORS].decode(torque)
        t2 = perf_counter_ns()
        experiment.answer(stamp_ns, theta, tau_h)
        t3 = perf_counter_ns()
        command = self.encode_command(experiment.command)
        perturbation = self.encoders[PERTURBATION].encode(stamp_ns, experiment.tau_delta)
        _, self.command = self.decode_command(command)
        t4 = perf_counter_ns()
        self.receivers[JOINT_STATES](position)
        self.receivers[TORQUE_SENSORS](torque)
        self.receivers[COMMANDS](command)
        self.receivers[PERTURBATION](perturbation)
        if experiment.tick % TOGETHER == 0:
            self.recording.add(self.synchronizer.take())
        return t1 - t0, t3 - t2, t2 - t1 + t4 - t3, perf_counter_ns() - t4


def tick_parts(config: ExperimentConfig, ticks: int = 4000) -> TickParts:
    """Run the beginning of an experiment without ROS, and time the parts of its ticks.

    Parameters
    ----------
    config : ExperimentConfig
    ticks : int
        Number of ticks of the first perturbation that are measured.

    Raises
    ------
    DataError
        If the experiment ends before that.
    """
    with tempfile.TemporaryDirectory() as folder:
        loop = _Loop(config, Path(folder))
        told = 0
        totals = [0, 0, 0, 0]
        left = ticks
        while left:
            spent = loop.tick()
            for status in loop.statuses[told:]:
                loop.recording.add_status(status)
            told = len(loop.statuses)
            phase = loop.statuses[-1].phase
            if phase in (Phase.ABORTED, Phase.DONE):
                raise DataError(f"the experiment ended: {loop.experiment.fault or phase.value}")
            if phase is Phase.PERTURB:
                left -= 1
                totals = [total + one for total, one in zip(totals, spent, strict=True)]
        loop.recording.stop()
    plant, law, codecs, recording = (total / ticks / NS_PER_S for total in totals)
    return TickParts(plant=plant, law=law, codecs=codecs, recording=recording)
