"""The configuration of an experiment, and the parameters of the nodes that follow from it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field, JsonValue, ValidationError, model_validator

from armimp_bringup.offline import Rig
from armimp_common.errors import ConfigurationError
from armimp_common.schema import Loader, build, check_names, explain, flatten, load_yaml
from armimp_common.topics import CONTROLLER_NODE, ESTIMATOR_NODE, SIM_NODE
from armimp_common.versions import git_revision, versions
from armimp_control.parameters import ControllerParameters
from armimp_estimation.atomic_write import read_text, require_text
from armimp_estimation.conclusion import TIMING_KEY
from armimp_estimation.parameters import EstimatorParameters, TorqueParameters
from armimp_sim.parameters import SimulatorParameters

Overrides = dict[str, JsonValue]
_MOST_BYTES = 1 << 18
_LARGEST = 1e20
"""Beyond any quantity here, whatever its unit; products of a few such numbers are still numbers."""


class ExperimentConfig(BaseModel):
    """What a user decides; everything else has its default in the parameters of the nodes."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    joints: Literal[1, 2, 3, 4, 5, 6, 7] = Field(
        default=2, description="number of joints of the preset arm"
    )
    friction: int = Field(default=3, ge=0, le=3, description="friction level")
    resolution: int = Field(default=3, ge=0, le=3, description="sensor resolution level, Table II")
    perturbation: int = Field(default=3, ge=1, le=3, description="perturbation level, Table III")
    duration: float = Field(default=50.0, ge=2.0, le=9000.0, description="of each trial (s)")
    seed: int = Field(default=1, ge=0, lt=2**63, description="of all random signals")
    mode: Literal["lockstep", "realtime"] = Field(default="lockstep", description="how time passes")
    processes: Literal["composed", "separate", "external"] = Field(
        default="composed",
        description="all nodes in one process, one process for each, or started by others; "
        "separate in realtime",
    )
    priority: int = Field(
        default=0, ge=0, le=99, description="SCHED_FIFO priority of rig and controller in realtime"
    )
    estimators: tuple[str, ...] = Field(
        default=("welch_siso", "lpm_full"), description="estimators of the result"
    )
    target_error: float = Field(
        default=0.0,
        ge=0.0,
        lt=1.0,
        description="relative standard error of M, B and K below which a trial ends; 0: never",
    )
    torque_delay: float | None = Field(
        default=None,
        ge=0.0,
        le=0.1,
        description="how late torque readings are, for the estimates (s); none: as simulated",
    )
    arm_sim: Overrides = Field(default={}, description="parameters of that node to override")
    imbic_controller: Overrides = Field(default={}, description="likewise")
    impedance_estimator: Overrides = Field(default={}, description="likewise")

    @model_validator(mode="before")
    @classmethod
    def _separate_in_realtime(cls, values: Any) -> Any:
        """What an estimator in the same process computes would hold the controller up."""
        if isinstance(values, Mapping) and values.get("mode") == "realtime":
            return {"processes": "separate", **values}
        return values


class _Loader(Loader):  # type: ignore[misc]
    """The safe one, which lets errors of Python through where a text is not what it looks like."""

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        try:
            return super().construct_object(node, deep=deep)
        except (ValueError, ArithmeticError, LookupError, AttributeError):
            kind = str(node.tag).rpartition(":")[2]
            raise yaml.constructor.ConstructorError(
                None, None, f"{node.value!r:.60} is no {kind}", node.start_mark
            ) from None


def load_config(path: Path | None, options: Mapping[str, Any]) -> ExperimentConfig:
    """Read a YAML file, and let the given options prevail.

    Parameters
    ----------
    path : Path or None
        The file; None for defaults.
    options : mapping
        Options of the command line; None values are ignored.

    Raises
    ------
    ConfigurationError
        If the file can't be read, or a value is wrong: one line that names it.
    """
    values: dict[str, Any] = {}
    if path is not None:
        try:
            require_text(path)
            loaded = load_yaml(read_text(path, _MOST_BYTES), _Loader)
        except OSError as error:
            raise ConfigurationError(f"{path}: {error.strerror}") from None
        except UnicodeDecodeError:
            raise ConfigurationError(f"{path}: is not a text file") from None
        except yaml.YAMLError as error:
            reason = " ".join(str(error).split())
            raise ConfigurationError(f"{path}: cannot be read as YAML: {reason:.300}") from None
        if loaded is not None and not isinstance(loaded, dict):
            raise ConfigurationError(f"{path}: should hold names and values, not {loaded!r:.60}")
        values.update(loaded or {})
    values.update({name: value for name, value in options.items() if value is not None})
    where = f"{path}: " if path is not None else ""
    try:
        check_names(map(str, values), ExperimentConfig.model_fields)
    except ConfigurationError as error:
        raise ConfigurationError(f"{where}{error}") from None
    try:
        return ExperimentConfig.model_validate(values)
    except ValidationError as error:
        raise ConfigurationError(f"{where}{explain(error)}") from None


@dataclass(frozen=True, kw_only=True)
class NodeParameters:
    """The parameters of the three nodes."""

    simulator: SimulatorParameters
    controller: ControllerParameters
    estimator: EstimatorParameters

    def by_node(self) -> dict[str, BaseModel]:
        """Parameters by the name of the node."""
        return {
            SIM_NODE: self.simulator,
            CONTROLLER_NODE: self.controller,
            ESTIMATOR_NODE: self.estimator,
        }

    def rig(self) -> Rig:
        """The same experiment for the offline loop."""
        return Rig(
            plant=self.simulator.plant_config(),
            voluntary=self.simulator.voluntary_config(),
            controller=self.controller.law_config(),
            safety=self.controller.safety_config(),
            perturbation=self.controller.perturbation_config(),
            sequence=self.controller.sequence_config(),
            seed=self.controller.seed,
        )


def node_parameters(config: ExperimentConfig, directory: Path | None) -> NodeParameters:
    """Parameters of the nodes for an experiment.

    Parameters
    ----------
    config : ExperimentConfig
    directory : Path or None
        Where the results go.

    Raises
    ------
    ConfigurationError
        If an override names no parameter, or a value is wrong, or the loop would be unstable.
    """
    try:
        return _node_parameters(config, directory)
    except (ArithmeticError, ValidationError, np.linalg.LinAlgError) as error:
        # Each value is within its limits, but they do not go together.
        reason = str(error.args[-1] if error.args else error).splitlines()[0]
        raise ConfigurationError(f"nothing can be computed with these values: {reason}") from None


def _node_parameters(config: ExperimentConfig, directory: Path | None) -> NodeParameters:
    time = _time_of(config)
    simulator = _overridden(
        _overridden(
            SimulatorParameters.preset(
                joints=config.joints,
                friction=config.friction,
                resolution=config.resolution,
                seed=config.seed,
            ),
            SIM_NODE,
            time,
        ),
        SIM_NODE,
        config.arm_sim,
    )
    plant = simulator.plant_config()
    controller = _overridden(
        _overridden(
            ControllerParameters.preset(
                joints=simulator.joints,
                posture=plant.arm.posture,
                robot_inertia=plant.robot.mass_matrix(plant.arm.posture),
                arm_inertia=plant.arm.inertia,
                perturbation=config.perturbation,
                duration=config.duration,
                seed=config.seed,
                encoder_resolution=plant.sensors.encoder_resolution,
            ),
            CONTROLLER_NODE,
            {**time, **_known_of(simulator)},
        ),
        CONTROLLER_NODE,
        config.imbic_controller,
    )
    if config.target_error:
        sequence = controller.sequence.model_copy(update={"may_end_early": True})
        controller = controller.model_copy(update={"sequence": sequence})
    controller.check()
    controller.perturbation_config()
    if simulator.mode != controller.mode:
        raise ConfigurationError(
            f"{SIM_NODE}: parameter 'mode' is {simulator.mode!r}, that of {CONTROLLER_NODE} "
            f"{controller.mode!r}: they must be the same"
        )
    estimator = EstimatorParameters(
        joints=simulator.joints,
        estimators=config.estimators,
        target_error=config.target_error,
        torque=TorqueParameters(
            delay=simulator.sensors.torque_delay,
            cutoff=simulator.sensors.torque_cutoff,
            order=simulator.sensors.torque_order,
            actuator_lag=simulator.actuators.lag,
        ),
        directory="" if directory is None else str(directory),
        metadata=json.dumps(bag_metadata(config, simulator, controller)),
    )
    estimator = _overridden(estimator, ESTIMATOR_NODE, config.impedance_estimator)
    if config.torque_delay is not None:
        estimator = _overridden(estimator, ESTIMATOR_NODE, {"torque.delay": config.torque_delay})
    estimator.bag_metadata()
    return NodeParameters(simulator=simulator, controller=controller, estimator=estimator)


def _known_of(simulator: SimulatorParameters) -> Overrides:
    """What the controller knows of drives and transducers: all that is simulated of them."""
    known = {
        "known.actuator_lag": simulator.actuators.lag,
        "known.torque_delay": simulator.sensors.torque_delay,
        "known.torque_cutoff": simulator.sensors.torque_cutoff,
    }
    told: Overrides = {name: value for name, value in known.items() if value}
    if simulator.sensors.torque_cutoff:
        told["known.torque_order"] = simulator.sensors.torque_order
    return told


def _time_of(config: ExperimentConfig) -> Overrides:
    """Parameters of simulator and controller that say how time passes."""
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
    """What is stored in every bag: configuration, truth, versions."""
    arm = simulator.human_arm()
    described = {
        "experiment": config.model_dump(mode="json"),
        SIM_NODE: flatten(simulator),
        CONTROLLER_NODE: flatten(controller),
        "versions": versions(),
        "git_revision": git_revision(),
    }
    truth = {
        "M": arm.inertia.tolist(),
        "B": arm.damping.tolist(),
        "K": arm.stiffness.tolist(),
    }
    return {
        "schema": "1",
        "config": json.dumps(described),
        "seed": json.dumps(config.seed),
        "joint_names": json.dumps(list(simulator.joints)),
        "truth": json.dumps(truth),
        TIMING_KEY: json.dumps(simulator.sensors.sampling.value),
    }


def _overridden(base: Any, node: str, overrides: Overrides) -> Any:
    if not overrides:
        return base
    try:
        found = build(type(base), {**flatten(base), **_dotted(overrides)})
    except ConfigurationError as error:
        raise ConfigurationError(f"{node}: {error}") from None
    for name, value in flatten(found).items():
        for number in value if isinstance(value, list) else (value,):
            if isinstance(number, float) and abs(number) > _LARGEST:
                raise ConfigurationError(f"{node}: parameter '{name}' = {number}: is too large")
    return found


def _dotted(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, Mapping):
            found |= _dotted(value, f"{prefix}{name}.")
        else:
            found[f"{prefix}{name}"] = _row_by_row(f"{prefix}{name}", value)
    return found


def _row_by_row(name: str, value: Any) -> Any:
    """A matrix that is written as a list of its rows, as the flat list that parameters are."""
    if not isinstance(value, list) or not any(isinstance(row, list) for row in value):
        return value
    lengths = {len(row) if isinstance(row, list) else None for row in value}
    if len(lengths) > 1:
        raise ConfigurationError(f"parameter '{name}' = {value!r:.80}: rows differ in length")
    if lengths != {len(value)}:
        rows = f"{len(value)} row{'s' * (len(value) > 1)}"
        raise ConfigurationError(f"parameter '{name}' has {rows} for {lengths.pop()} columns")
    return [number for row in value for number in row]
