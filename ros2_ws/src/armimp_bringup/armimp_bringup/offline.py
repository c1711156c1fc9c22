"""Experiments without ROS: plant and law in one compiled loop, many conditions side by side.

The arithmetic is that of the nodes, in the order of the lockstep graph: sample k, command k, one
period of the plant, sample k + 1. For the same seed the trajectories are equal bit for bit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.parameters import NodeParameters, node_parameters
from armimp_common.arrays import FloatArray, IntArray
from armimp_common.compiled import compiled_entry
from armimp_common.errors import ConfigurationError, DataError
from armimp_common.status import Phase
from armimp_common.topics import PERIOD_NS, RATE
from armimp_control.laws import NO_JOINT
from armimp_control.laws.law import Controller, packed_size, packed_tick
from armimp_control.parameters import ControllerParameters
from armimp_control.sequence import Segment, timetable
from armimp_estimation.estimators.estimate import Estimator
from armimp_estimation.identify import Identification, identify_records
from armimp_estimation.mbk import MBK
from armimp_estimation.metadata import Metadata
from armimp_estimation.record import TrialRecord
from armimp_sim.dynamics import Batch
from armimp_sim.plant import Plant, check_ratio, tick
from armimp_sim.real_rig import RealRig
from armimp_sim.voluntary import reading_noise, voluntary_torque


@compiled_entry
def _run_segment(
    batch: Batch,
    real: RealRig | None,
    laws: IntArray,
    controllers: FloatArray,
    tau_delta: FloatArray,
    voluntary: FloatArray,
    noise: FloatArray,
    record: FloatArray,
) -> float:
    """Run the ticks of a segment, and return the worst h·σ0|v|/g(v), NaN if a lane diverged.

    The rigs are as for :func:`armimp_sim.plant.tick`, laws (lanes,) and controllers (lanes,
    packed_size(n)) as for :func:`armimp_control.laws.law.packed_tick`. Perturbation and voluntary
    torque are (ticks, lanes, n), noise (ticks or 1, lanes, 2, n), whose last row is repeated, and
    the record (3, lanes, n, ticks): positions, torques, commands.
    """
    position, torque = batch.position, batch.torque
    m, n = position.shape
    command = np.zeros((m, n))
    worst = 0.0
    for k in range(tau_delta.shape[0]):
        for lane in range(m):
            w = controllers[lane]
            for i in range(n):
                w[i], w[n + i] = position[lane, i], torque[lane, i]
                w[2 * n + i] = tau_delta[k, lane, i]
            packed_tick(laws[lane], n, w)
            for i in range(n):
                command[lane, i] = w[3 * n + i]
                record[0, lane, i, k] = position[lane, i]
                record[1, lane, i, k] = torque[lane, i]
                record[2, lane, i, k] = command[lane, i]
        ratio = tick(batch, real, command, voluntary[k], noise[min(k, len(noise) - 1)])
        if not ratio <= worst:
            worst = ratio
            if not worst < np.inf:
                return np.nan
    return worst


Signals = Callable[[Segment], tuple[FloatArray, int | None]]
"""Returns τ_Δ (ticks, lanes, n) of a segment, N·m, and the joint that yields; None: all joints."""


def _perturbations(
    laws: Sequence[ControllerParameters], segment: Segment
) -> tuple[FloatArray, int]:
    tau_delta = np.zeros((segment.ticks, len(laws), len(laws[0].joints)))
    if segment.phase is Phase.PERTURB:
        for lane, one in enumerate(laws):
            signal = one.signal(segment.joint, trial=segment.trial, ticks=segment.ticks)
            tau_delta[:, lane, segment.joint] = signal
    return tau_delta, segment.joint


def run_offline(
    experiments: Sequence[NodeParameters],
    segments: Sequence[Segment] | None = None,
    signals: Signals | None = None,
) -> list[list[TrialRecord]]:
    """Run experiments side by side.

    Parameters
    ----------
    experiments : one per lane; they must agree in joints, timing and sequence
    segments : the timetable; by default that of the experiments, with one trial for each joint
    signals : the perturbation; by default that of the experiments, of one joint in each trial.
        Where all joints yield, the first one counts as the perturbed one.

    Returns
    -------
    list of list of TrialRecord
        For each experiment, its trials in order.

    Raises
    ------
    ConfigurationError, DataError
        If numbers of joints or sequences differ, a tare is refused, or a safety limiter stopped.
    IntegrationError
        If the plant left the stability region of the integrator.
    """
    of_laws = [one.controller for one in experiments]
    first = of_laws[0]
    if any((one.sequence, one.tare) != (first.sequence, first.tare) for one in of_laws):
        raise DataError("offline run: all rigs must have the same trial sequence")
    rigs = [one.simulator for one in experiments]
    plant = Plant(rigs)
    n, lanes = len(first.joints), len(rigs)
    if len(rigs[0].joints) != n:
        raise ConfigurationError(
            f"offline run: {len(rigs[0].joints)} joints of the plant, {n} of the controller"
        )
    packed = np.zeros((lanes, packed_size(n)))
    controllers = [
        Controller(one.control_law(), safety=one.safety, storage=own)
        for one, own in zip(of_laws, packed, strict=True)
    ]
    laws = np.array([controller.law.kind for controller in controllers])
    streams = [voluntary_torque(one.voluntary, joints=n, seed=one.seed) for one in rigs]
    noises = [reading_noise(one.sensors, joints=n, seed=one.seed) for one in rigs]
    trials: list[list[TrialRecord]] = [[] for _ in rigs]
    segments = segments or timetable(first.sequence, joints=n, tare=first.tare)
    signals = signals or partial(_perturbations, of_laws)
    for segment in segments:
        tau_delta, yielding = signals(segment)
        for controller in controllers:
            controller.perturb_joint(NO_JOINT if segment.tare else yielding)
        record = np.empty((3, lanes, n, segment.ticks))
        worst = _run_segment(
            plant.batch,
            plant.real,
            laws,
            packed,
            tau_delta,
            np.stack([stream.take(segment.ticks) for stream in streams], axis=1),
            # An ideal rig has no noise of the readings in any tick.
            np.stack([one.take(segment.ticks if plant.real else 1) for one in noises], axis=1),
            record,
        )
        check_ratio(worst, plant.batch.step)
        for controller in controllers:
            if fault := controller.fault[1]:
                raise DataError(
                    f"offline run: the safety limiter stopped in trial {segment.trial}: {fault}"
                )
        if segment.tare:
            for lane, (one, controller) in enumerate(zip(of_laws, controllers, strict=True)):
                tare = one.tare.of(record[1, lane])
                if refusal := one.tare.refusal(tare, one.joints):
                    raise DataError(f"offline run: {refusal}")
                controller.tare(tare.offset)
        if segment.phase is not Phase.PERTURB:
            continue
        for lane, one in enumerate(of_laws):
            position, torque, command = record[:, lane].copy()
            trials[lane].append(
                TrialRecord(
                    trial=segment.trial,
                    perturbed_joint=yielding or 0,
                    rate=RATE,
                    joint_names=one.joints,
                    perturbation=tau_delta[:, lane].T,
                    position=position,
                    torque=torque,
                    command=command,
                    start_ns=segment.first * PERIOD_NS,
                )
            )
    return trials


@dataclass(frozen=True, kw_only=True, eq=False)
class SimulatedExperiment:
    """The records of one experiment, and the truth behind them."""

    config: ExperimentConfig
    """Configuration, with the seed."""
    parameters: NodeParameters
    """Parameters of the nodes that follow from it."""
    records: tuple[TrialRecord, ...]
    """One for each trial."""

    @property
    def truth(self) -> MBK:
        """The arm that was simulated."""
        arm = self.parameters.simulator.arm
        return MBK(M=arm.M, B=arm.B, K=arm.K)

    @property
    def known(self) -> Metadata:
        """The metadata that a bag of this experiment would hold beside the samples."""
        return Metadata.of(self.parameters.estimator.bag_metadata())

    def identify(self, estimators: Sequence[str | Estimator]) -> Identification:
        """Estimate, compare with the truth and judge; see :func:`armimp_estimation.identify`.

        Raises
        ------
        ConfigurationError
            If there is no such estimator.
        DataError
            If the records cannot be estimated.
        """
        return identify_records([[one] for one in self.records], estimators, self.known)


def simulate(configs: Sequence[ExperimentConfig]) -> list[SimulatedExperiment]:
    """Run experiments side by side in the loop without ROS, with one trial for each joint.

    Samples are those of ``armimp run`` with the same configuration, to the last bit.

    Parameters
    ----------
    configs : all with the same number of joints and the same duration

    Raises
    ------
    ConfigurationError, DataError, IntegrationError
        If a configuration makes no experiment, or the experiment cannot be simulated.
    """
    parameters = [node_parameters(one, None) for one in configs]
    trials = run_offline(parameters)
    return [
        SimulatedExperiment(config=config, parameters=one, records=tuple(of_config))
        for config, one, of_config in zip(configs, parameters, trials, strict=True)
    ]
