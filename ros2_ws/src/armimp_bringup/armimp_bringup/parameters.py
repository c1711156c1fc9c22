"""The parameters of the nodes, as they follow from the configuration of an experiment."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ValidationError

from armimp_bringup.config import ExperimentConfig, Overrides
from armimp_common.errors import ConfigurationError
from armimp_common.schema import ModelT, build, dotted, flatten
from armimp_common.topics import CONTROLLER_NODE, ESTIMATOR_NODE, RATE, SIM_NODE
from armimp_common.versions import software
from armimp_control.parameters import ControllerParameters
from armimp_control.presets import LawName
from armimp_control.rig import RigDynamics
from armimp_estimation.metadata import CALIBRATION_KEYS, READING_KEYS
from armimp_estimation.parameters import EstimatorParameters
from armimp_sim.parameters import SimulatorParameters

_LARGEST = 1e20
"""Beyond any quantity here, whatever its unit; products of a few such numbers are still finite."""


@dataclass(frozen=True, kw_only=True)
class NodeParameters:
    """The parameters of the three nodes, which decide the course of an experiment."""

    simulator: SimulatorParameters
    controller: ControllerParameters
    estimator: EstimatorParameters

    def by_node(self) -> dict[str, BaseModel]:
        """Return the parameters of each node by its name."""
        return {
            SIM_NODE: self.simulator,
            CONTROLLER_NODE: self.controller,
            ESTIMATOR_NODE: self.estimator,
        }


def node_parameters(config: ExperimentConfig, directory: Path | None) -> NodeParameters:
    """Return the parameters of the nodes for an experiment.

    Parameters
    ----------
    config : ExperimentConfig
    directory : where the results go

    Raises
    ------
    ConfigurationError
        If an override names no parameter, or a value is wrong, or the loop would be unstable.
    """
    try:
        simulator = _simulator(config)
        controller = _controller(config, simulator)
        estimator = _estimator(config, directory, simulator, controller)
    except (ArithmeticError, ValidationError, np.linalg.LinAlgError) as error:
        # Each value is within its own limits, but their combination is impossible.
        reason = str(error.args[-1] if error.args else error).splitlines()[0]
        raise ConfigurationError(f"nothing can be computed with these values: {reason}") from None
    return NodeParameters(simulator=simulator, controller=controller, estimator=estimator)


def _simulator(config: ExperimentConfig) -> SimulatorParameters:
    preset = SimulatorParameters.preset(
        joints=config.joints,
        friction=config.friction,
        resolution=config.resolution,
        seed=config.seed,
        rig=config.rig,
    )
    return _overridden(preset, SIM_NODE, {**_time_of(config), **config.arm_sim})


def _controller(config: ExperimentConfig, simulator: SimulatorParameters) -> ControllerParameters:
    simulator.check()
    overrides = {**_time_of(config), **_known_of(simulator), **config.imbic_controller}
    preset = ControllerParameters.preset(
        joints=simulator.joints,
        posture=simulator.arm.theta_0,
        robot_inertia=simulator.robot.mass_matrix(simulator.arm.theta_0),
        arm_inertia=simulator.arm.M,
        perturbation=config.perturbation,
        perturbation_kind=config.perturbation_kind,
        duration=config.duration,
        seed=config.seed,
        encoder_resolution=simulator.sensors.position.resolution,
        law=_law(config, overrides),
    )
    if config.target_error:
        overrides["sequence.may_end_early"] = True
    controller = _overridden(preset, CONTROLLER_NODE, overrides)
    controller.check()
    if simulator.mode != controller.mode:
        raise ConfigurationError(
            f"{SIM_NODE}: parameter 'mode' is {simulator.mode!r}, that of {CONTROLLER_NODE} "
            f"{controller.mode!r}: they must be the same"
        )
    return controller


def _law(config: ExperimentConfig, overrides: Overrides) -> LawName:
    """Return the preset of the law; for an observer and a rig with a known lag, the patient one."""
    if config.as_in_paper:
        return "paper"
    of_rig = {f"known.{name}" for name in RigDynamics.model_fields}
    lags = any(value for name, value in dotted(overrides).items() if name in of_rig)
    return "patient" if lags and config.internal_model == "observer" else config.internal_model


def _estimator(
    config: ExperimentConfig,
    directory: Path | None,
    simulator: SimulatorParameters,
    controller: ControllerParameters,
) -> EstimatorParameters:
    preset = EstimatorParameters(
        joints=simulator.joints,
        estimators=config.estimators,
        target_error=config.target_error,
        directory="" if directory is None else str(directory),
        metadata=json.dumps(bag_metadata(config, simulator, controller)),
    )
    estimator = _overridden(preset, ESTIMATOR_NODE, config.impedance_estimator)
    estimator.bag_metadata()
    return estimator


def _known_of(simulator: SimulatorParameters) -> Overrides:
    """Return what the controller knows of drives and transducers: all that is simulated."""
    torque, actuators = simulator.sensors.torque, simulator.actuators
    known: Overrides = {
        # A delay by a fraction of a period is as bad as that by a whole one, so it is rounded up.
        "known.command_delay": math.ceil(actuators.delay * RATE - 1e-6),
        "known.actuator_lag": actuators.lag,
        "known.torque_delay": torque.delay,
        "known.torque_cutoff": torque.cutoff,
    }
    if torque.cutoff:
        known["known.torque_order"] = torque.order
    return {name: value for name, value in known.items() if value}


def _time_of(config: ExperimentConfig) -> Overrides:
    """Return the parameters of simulator and controller that say how time passes."""
    if config.mode == "lockstep":
        if config.priority:
            raise ConfigurationError(
                f"priority = {config.priority} is for mode realtime; in lockstep nothing is urgent"
            )
        return {}
    return {"mode": config.mode, "realtime.priority": config.priority}


def bag_metadata(
    config: ExperimentConfig, simulator: SimulatorParameters, controller: ControllerParameters
) -> dict[str, str]:
    """Return the metadata of every bag: configuration, truth, versions, torque readings."""
    arm = simulator.arm
    dynamics = {key: value for key, value in controller.known if key in READING_KEYS}
    if config.torque_delay is not None:
        dynamics["torque_delay"] = config.torque_delay
    if not controller.known.torque_cutoff:
        del dynamics["torque_order"]
    described = {
        "experiment": config.model_dump(mode="json"),
        SIM_NODE: flatten(simulator),
        CONTROLLER_NODE: flatten(controller),
        **software(),
    }
    metadata: dict[str, Any] = {
        "schema": 1,
        "config": described,
        "seed": config.seed,
        "joint_names": simulator.joints,
        "truth": {"M": arm.M.tolist(), "B": arm.B.tolist(), "K": arm.K.tolist()},
        "torque_timing": simulator.sensors.sampling,
        "torque_uncertainty": 0,
        **{key: value for key, value in dynamics.items() if value},
        # Sensors with simulated calibration errors must not be declared exact.
        **(dict.fromkeys(CALIBRATION_KEYS, 0) if simulator.sensors.torque.calibrated else {}),
        **({"arm_model": "cuff"} if simulator.cuff.stiffness else {}),
    }
    return {key: json.dumps(value) for key, value in metadata.items()}


def _overridden(base: ModelT, node: str, overrides: Overrides) -> ModelT:
    if not overrides:
        return base
    try:
        given = {name: _row_by_row(name, value) for name, value in dotted(overrides).items()}
        found = build(type(base), {**flatten(base), **given})
    except ConfigurationError as error:
        raise ConfigurationError(f"{node}: {error}") from None
    for name, value in flatten(found).items():
        for number in value if isinstance(value, list) else (value,):
            if isinstance(number, float) and abs(number) > _LARGEST:
                raise ConfigurationError(f"{node}: parameter '{name}' = {number}: is too large")
    return found


def _row_by_row(name: str, value: Any) -> Any:
    """Flatten a matrix written as a list of its rows, since parameters are flat lists."""
    if not isinstance(value, list) or not any(isinstance(row, list) for row in value):
        return value
    if any(not isinstance(row, list) or len(row) != len(value) for row in value):
        raise ConfigurationError(f"parameter '{name}' = {value!r:.80}: is no square matrix")
    return [number for row in value for number in row]
