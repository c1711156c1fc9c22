"""Whole experiments without ROS: from a configuration to records, and from these to a result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.offline import OfflineTrial, run_offline
from armimp_bringup.parameters import NodeParameters, node_parameters
from armimp_common.topics import NS_PER_S, PERIOD_NS
from armimp_estimation.estimators.estimate import Estimator
from armimp_estimation.estimators.lpm import LpmConfig
from armimp_estimation.estimators.registry import IdentifyConfig
from armimp_estimation.identify import Identification, identify
from armimp_estimation.mbk import MBK
from armimp_estimation.metadata import reading_of
from armimp_estimation.record import TrialRecord
from armimp_estimation.spectra import WelchConfig
from armimp_estimation.trial import TrialData

RATE = NS_PER_S / PERIOD_NS
"""Samples per second, Hz."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SimulatedExperiment:
    """The records of one experiment, and the truth behind them.

    Attributes
    ----------
    config : with its seed
    parameters : of the nodes, as they follow from it
    records : one for each trial
    """

    config: ExperimentConfig
    parameters: NodeParameters
    records: tuple[TrialRecord, ...]

    @classmethod
    def of(
        cls, config: ExperimentConfig, parameters: NodeParameters, trials: Sequence[OfflineTrial]
    ) -> SimulatedExperiment:
        """Make records of what the offline loop gives."""
        records = tuple(
            TrialRecord(
                trial=number,
                perturbed_joint=trial.joint,
                rate=RATE,
                joint_names=parameters.simulator.joints,
                perturbation=trial.perturbation,
                position=trial.position,
                torque=trial.torque,
                command=trial.command,
                start_ns=trial.first_tick * PERIOD_NS,
                seed=config.seed,
            )
            for number, trial in enumerate(trials, start=1)
        )
        return cls(config=config, parameters=parameters, records=records)

    @property
    def truth(self) -> MBK:
        """The arm that was simulated."""
        arm = self.parameters.simulator.human_arm()
        return MBK(M=arm.inertia, B=arm.damping, K=arm.stiffness)

    @property
    def options(self) -> IdentifyConfig:
        """Options of an estimate that suit the shortest record and the sensors."""
        reading = reading_of(self.parameters.estimator.bag_metadata())
        shortest = min(record.samples for record in self.records)
        welch = WelchConfig.for_samples(shortest)
        return IdentifyConfig(welch=welch, lpm=LpmConfig(reading=reading))

    def identify(self, estimators: Sequence[str | Estimator]) -> Identification:
        """Estimate, compare with the truth and judge; see :func:`armimp_estimation.identify`.

        Raises
        ------
        ConfigurationError
            If there is no such estimator.
        DataError
            If the records cannot be estimated.
        """
        options = self.options
        data = [
            TrialData.from_record(record, options.welch, options.lpm.reading)
            for record in self.records
        ]
        return identify(data, estimators, self.truth, options)

    def shortened(self, samples: int) -> SimulatedExperiment:
        """The same as if each trial had ended after so many samples."""
        return replace(self, records=tuple(_shortened(one, samples) for one in self.records))


def simulate(configs: Sequence[ExperimentConfig]) -> list[SimulatedExperiment]:
    """Run experiments side by side in the loop without ROS, with one trial for each joint.

    Samples are those of ``armimp run`` with the same configuration, to the last bit.

    Parameters
    ----------
    configs : of one number of joints and duration

    Raises
    ------
    ConfigurationError, DataError, IntegrationError
        If a configuration does not make an experiment, or it cannot be simulated.
    """
    parameters = [node_parameters(one, None) for one in configs]
    trials = run_offline([one.rig() for one in parameters])
    return [
        SimulatedExperiment.of(config, one, of_config)
        for config, one, of_config in zip(configs, parameters, trials, strict=True)
    ]


def _shortened(record: TrialRecord, samples: int) -> TrialRecord:
    return replace(
        record,
        perturbation=record.perturbation[:, :samples],
        position=record.position[:, :samples],
        torque=record.torque[:, :samples],
        command=None if record.command is None else record.command[:, :samples],
    )
