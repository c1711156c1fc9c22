"""Configuration of an experiment by file or options, and the directory of its results."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import (
    BeforeValidator,
    Field,
    JsonValue,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)
from typing_extensions import Self

from armimp_common.errors import ConfigurationError
from armimp_common.schema import ModelT, Schema, Vector, check_names, explain, load_yaml
from armimp_common.topics import SIM_NODE
from armimp_control.perturbation import PerturbationKind
from armimp_estimation.atomic_write import read_text, require_text

Overrides = dict[str, JsonValue]
_MOST_BYTES = 1 << 18


def _share(value: object) -> object:
    """Return a share between 0 and 1 as a number; a text may give it in per cent, as 2%."""
    if not isinstance(value, str):
        return value
    percent = value.strip().endswith("%")
    try:
        share = float(value.strip().removesuffix("%")) / (100.0 if percent else 1.0)
    except ValueError:
        share = math.nan
    if not 0.0 <= share < 1.0:
        hint = "" if percent or not 1.0 <= share < 100.0 else f"; did you mean {value.strip()}%?"
        raise ValueError(f"is no share such as 2% or 0.02{hint}")
    return share


class ExperimentConfig(Schema):
    """Choices of a user; everything else has its default in the parameters of the nodes.

    Each field except the overrides of single nodes is an option of ``armimp run``; the docstring
    of the field is the help of the option.
    """

    joints: Literal[1, 2, 3, 4, 5, 6, 7] = 2
    """Joints of the preset arm, 1 to 7; 2 is the paper's arm of shoulder and elbow."""
    friction: int = Field(default=3, ge=0, le=3)
    """Level of joint friction: 0 none; 1, 2, 3 Coulomb friction of 0.4, 1, 2 N·m."""
    resolution: int = Field(default=3, ge=0, le=3)
    """Level of sensor resolution: 0 exact; 1, 2, 3 encoder steps of 360°/204800, /102400, /51200
    and torque steps of 5, 10, 20 mN·m."""
    perturbation: int = Field(default=3, ge=1, le=3)
    """Level of the perturbing torque: 1, 2, 3 peaks of 3, 6, 9 N·m at the shoulder and 1.8, 3.6,
    5.4 N·m at the elbow."""
    perturbation_kind: PerturbationKind = "noise"
    """Kind of the perturbing torque: noise; multisine, periodic with the rms of that noise and half
    its peak, which separates noise, distortion and change over time; or optimal, a multisine with
    the peak of that noise at the most informative frequencies."""
    rig: Literal["paper", "realistic"] = "paper"
    """Simulated rig: paper, or realistic, with drives, transducers, cuff and person as a good rig
    has them."""
    internal_model: Literal["observer", "tde"] = "observer"
    """Internal model of the control law: observer, or tde, time-delay estimation with raw
    differences of the encoders, whose torques no drive can follow."""
    as_in_paper: bool = False
    """Use only what the paper has: time-delay estimation; locked joints without approach, dither
    and stiffer target."""
    duration: float = Field(default=50.0, ge=2.0, le=9000.0)
    """Length of each trial, s; 2 to 9000."""
    seed: int = Field(default=1, ge=0, lt=2**63)
    """Seed of all random signals."""
    mode: Literal["lockstep", "realtime"] = "lockstep"
    """How time passes: lockstep (as fast as the machine, repeatable) or realtime (1 kHz by the wall
    clock)."""
    processes: Literal["composed", "separate", "external"] = "composed"
    """Where the nodes live: composed (in one process), separate (one for each, as by default in
    realtime) or external (started by others)."""
    priority: int = Field(default=0, ge=0, le=99)
    """SCHED_FIFO priority of rig and controller in realtime, 1 to 99; 0: ordinary."""
    estimators: tuple[str, ...] = ("welch_siso", "lpm_full")
    """Estimator: welch_siso, welch_full, lpm_full. May be given more than once."""
    target_error: Annotated[float, BeforeValidator(_share)] = Field(
        default=0.0,
        ge=0.0,
        lt=1.0,
        json_schema_extra={"type": "string"},  # of the option
    )
    """End a trial once relative standard errors of M, B, K are below this: 2% or 0.02; 0: never."""
    torque_delay: float | None = Field(default=None, ge=0.0, le=0.1)
    """Delay of torque readings, s, which the estimates correct; by default known.torque_delay of
    the controller."""
    arm_sim: Overrides = Field(default_factory=dict)
    """Parameters of arm_sim to override."""
    imbic_controller: Overrides = Field(default_factory=dict)
    """Parameters of imbic_controller to override."""
    impedance_estimator: Overrides = Field(default_factory=dict)
    """Parameters of impedance_estimator to override."""

    @field_validator("*", mode="before")
    @classmethod
    def _no_truth(cls, value: object, info: ValidationInfo) -> object:
        """Refuse a truth value, which would be taken for the number 0 or 1."""
        if (
            isinstance(value, bool)
            and cls.model_fields[str(info.field_name)].annotation is not bool
        ):
            raise ValueError("should be no truth value")
        return value

    @model_validator(mode="after")
    def _one_internal_model(self) -> Self:
        chosen = self.internal_model if "internal_model" in self.model_fields_set else "tde"
        if self.as_in_paper and chosen != "tde":
            raise ValueError(
                f"as_in_paper (--as-in-paper) has the internal model tde, not internal_model"
                f" (--internal-model) {chosen}"
            )
        return self

    @model_validator(mode="before")
    @classmethod
    def _separate_in_realtime(cls, values: Any) -> Any:
        """Default to separate processes in real time: an estimator would delay the controller."""
        if isinstance(values, Mapping) and values.get("mode") == "realtime":
            return {"processes": "separate", **values}
        return values


class Declared(Schema):
    """Declarations of a user about a recording; unless None, they override what the bags say.

    Aliases are the keys of bags.
    """

    torque_timing: Literal["before", "after", "mid", "mean", "simultaneous"] | None = None
    """When torques are read: before, after, mid, mean or simultaneous; by default as recorded with
    the bags, else inferred."""
    torque_delay: float | None = Field(default=None, ge=-0.1, le=0.1)
    """Delay of torque readings beyond their timing, s, negative if early; by default as recorded
    with the bags, else fitted."""
    torque_uncertainty: float | None = Field(default=None, ge=0.0, le=0.1)
    """Standard error of the timing of torque readings, s; by default 20 µs."""
    gain_uncertainty: float | None = Field(default=None, ge=0.0, le=1.0)
    """Standard error of the gain of each torque transducer, relative; by default as recorded with
    the bags, else 0.01."""
    cross_talk_uncertainty: float | None = Field(default=None, ge=0.0, le=1.0)
    """Standard error of the share of another joint's torque that each transducer shows; by default
    as recorded with the bags, else 0.01."""
    angle_uncertainty: float | None = Field(default=None, ge=0.0, le=1.0)
    """Standard error of the scale of each encoder at the posture, relative; by default as recorded
    with the bags, else 0.015."""
    linearity_uncertainty: float | None = Field(default=None, ge=0.0)
    """Standard error of each torque due to hysteresis and nonlinearity of its transducer, N·m; by
    default as recorded with the bags, else what the records leave open."""
    robot_inertia: Vector | None = None
    """Element of the inertia of the robot in the posture, kg·m²; repeat, row by row; by default as
    recorded with the bags, else unknown."""
    robot_inertia_uncertainty: float | None = Field(default=None, ge=0.0, le=1.0)
    """Standard error of each of these elements, relative to those on the diagonal; by default as
    recorded with the bags, else 0.05."""
    model: Literal["auto", "mbk", "mbk_delay", "reflex", "cuff"] | None = Field(
        default=None, serialization_alias="arm_model"
    )
    """Model of the arm to fit beside M, B and K: auto, mbk, mbk_delay, reflex or cuff; auto tries
    all where M, B and K don't fit; by default as recorded with the bags, else auto."""
    rate: float | None = Field(
        default=None, ge=200.0, le=4000.0, serialization_alias="sampling_rate"
    )
    """Sampling rate, Hz, if the recording has an unusual one."""


class CheckOptions(Schema):
    """Options of a check of a driver."""

    joints: tuple[str, ...] = ("shoulder", "elbow")
    """Name of a joint, in the order of commands; repeat."""
    node: str = SIM_NODE
    """Name of the node."""
    namespace: str = ""
    """Namespace of the driver."""
    duration: float = Field(default=5.0, ge=1.0, le=3600.0)
    """Length of the recording, s."""
    move: bool = False
    """Command torque; nobody may be in the rig."""
    # A typing error must not lead to a dangerous torque.
    torque: float = Field(default=1.0, gt=0.0, le=20.0)
    """Torque of each push, N·m; at most 20."""
    most_motion: float = Field(default=0.3, gt=0.0, le=1.0)
    """Motion of a joint beyond which the torque is removed, rad; at most 1."""

    @field_validator("joints")
    @classmethod
    def _distinct(cls, joints: tuple[str, ...]) -> tuple[str, ...]:
        if len(set(joints)) < len(joints) or not all(joints):
            raise ValueError("names are not distinct")
        return joints


def checked(model: type[ModelT], values: Mapping[str, Any]) -> ModelT:
    """Return the instance of a model with these values.

    Raises
    ------
    ConfigurationError
        If a name is not that of a field, or a value is wrong; one line names it.
    """
    check_names(map(str, values), model.model_fields)
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise ConfigurationError(explain(error)) from None


def load_config(path: Path | None, options: Mapping[str, Any]) -> ExperimentConfig:
    """Read a YAML file, and let the given options override it.

    Parameters
    ----------
    path : the file; None for defaults
    options : options of the command line; None values are ignored

    Raises
    ------
    ConfigurationError
        If the file can't be read, or a value is wrong; one line names it.
    """
    given = {name: value for name, value in options.items() if value is not None}
    values = {**({} if path is None else _read(path)), **given}
    try:
        return checked(ExperimentConfig, values)
    except ConfigurationError as error:
        where = f"{path}: " if path is not None else ""
        raise ConfigurationError(f"{where}{error}") from None


def _read(path: Path) -> dict[str, Any]:
    try:
        require_text(path)
        loaded = load_yaml(read_text(path, _MOST_BYTES))
    except OSError as error:
        raise ConfigurationError(f"{path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ConfigurationError(f"{path}: is not a text file") from None
    # For values such as the date 2026-13-01 the loader raises Python's own errors.
    except (yaml.YAMLError, ValueError, ArithmeticError, LookupError, AttributeError) as error:
        reason = " ".join(str(error).split())
        raise ConfigurationError(f"{path}: cannot be read as YAML: {reason:.300}") from None
    if loaded is not None and not isinstance(loaded, dict):
        raise ConfigurationError(f"{path}: should hold names and values, not {loaded!r:.60}")
    return loaded or {}


def require_unused(directory: Path) -> None:
    """Refuse an output directory that is not empty; it need not exist yet.

    Raises
    ------
    ConfigurationError
        If it exists and is not an empty directory.
    """
    try:
        require_text(directory)
        used = directory.exists() and any(directory.iterdir())
    except OSError as error:
        raise ConfigurationError(f"{directory}: cannot be made: {error.strerror}") from None
    if used:
        raise ConfigurationError(f"{directory}: is not empty, nothing is overwritten")


def prepare_directory(directory: Path) -> None:
    """Make the output directory; one that is not empty is refused.

    Raises
    ------
    ConfigurationError
        If it exists and is not an empty directory, or can't be made.
    """
    require_unused(directory)
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigurationError(f"{directory}: cannot be made: {error.strerror}") from None
