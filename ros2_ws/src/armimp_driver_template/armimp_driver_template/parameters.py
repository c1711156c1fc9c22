"""Parameters of the driver: the one place of their names, defaults and meaning."""

from __future__ import annotations

import math
from typing import Any, Literal, TypeVar

from pydantic import Field, ValidationError

from armimp_common.errors import ConfigurationError
from armimp_common.protection import ProtectionLimits
from armimp_common.schema import Schema, explain
from armimp_driver_template.conversion import Calibration, Drive

Kind = TypeVar("Kind")


class SensorParameters(Schema):
    """Calibration of one kind of sensor; each value is one for all joints or one for each."""

    resolution: tuple[float, ...]
    """Resolution of the sensor (rad or N·m)."""
    zero: tuple[int, ...]
    """Count of the sensor at zero."""
    sign: tuple[int, ...] = (1,)
    """-1 where the sensor counts the other way than the joint, else 1."""
    gear: tuple[float, ...] = (1.0,)
    """What the sensor sees for 1 rad or 1 N·m of the joint."""

    def calibration(self, name: str, joints: int) -> tuple[Calibration, ...]:
        """The calibration of each joint.

        Raises
        ------
        ConfigurationError
            If there are not enough values, or one is out of range; ``name`` is in the message.
        """
        return _of_joints(Calibration, name, joints, self)


class DriveParameters(Schema):
    """The drives; each value is one for all joints or one for each."""

    sign: tuple[int, ...] = (1,)
    """-1 where the drive turns the other way than the joint, else 1."""
    gear: tuple[float, ...] = (1.0,)
    """Turns of the drive for one of the joint."""

    def drives(self, joints: int) -> tuple[Drive, ...]:
        """The drive of each joint; raises as :meth:`SensorParameters.calibration`."""
        return _of_joints(Drive, "drive", joints, self)


class MockParameters(Schema):
    """The mock in the place of a device."""

    friction: int = Field(default=3, ge=0, le=3)
    """Friction level of the rig."""
    latency: int = Field(default=0, ge=0, le=100)
    """Periods by which commands act late."""
    dropout: float = Field(default=0.0, ge=0.0, lt=1.0)
    """Share of frames that are lost."""
    offset: tuple[float, ...] = (0.0,)
    """Offset of the transducers (N·m), one for all joints or each."""
    drift: tuple[float, ...] = (0.0,)
    """Drift of the transducers (N·m/s), one for all joints or each."""
    delay: float = Field(default=0.0, ge=0.0, le=0.1)
    """Delay of the readings of torque (s)."""
    cutoff: float = Field(default=0.0, ge=0.0)
    """Anti-alias low-pass of the torque (Hz); 0: none."""
    lag: float = Field(default=0.0, ge=0.0, le=0.1)
    """Time constant of the drives (s); 0: none."""
    names: tuple[str, ...] = ()
    """Names of the joints in the frames of the mock; empty: the same."""
    seed: int = Field(default=1, ge=0)
    """Seed of the frames that are lost."""


class DriverParameters(Schema):
    """All parameters of the driver."""

    joints: tuple[str, ...] = ("shoulder", "elbow")
    """Names of the joints, in the order of commands."""
    device_names: tuple[str, ...] = ()
    """Names of the same joints at the device; empty: the same names."""
    mode: Literal["lockstep", "realtime"] = "realtime"
    """lockstep: time waits for commands, with the mock only."""
    encoder: SensorParameters = SensorParameters(resolution=(2.0 * math.pi / 51200,), zero=(60000,))
    transducer: SensorParameters = SensorParameters(resolution=(0.02,), zero=(1250, -400))
    drive: DriveParameters = DriveParameters()
    limits: ProtectionLimits = ProtectionLimits()
    mock: MockParameters = MockParameters()

    def names_at_device(self) -> tuple[str, ...]:
        """The device's name of each joint."""
        return self.device_names or self.joints

    def encoders(self) -> tuple[Calibration, ...]:
        """Calibration of the encoders, by joint."""
        return self.encoder.calibration("encoder", len(self.joints))

    def transducers(self) -> tuple[Calibration, ...]:
        """Calibration of the transducers, by joint."""
        return self.transducer.calibration("transducer", len(self.joints))

    def drives(self) -> tuple[Drive, ...]:
        """The drives, by joint."""
        return self.drive.drives(len(self.joints))

    def check(self) -> None:
        """Check what concerns several parameters.

        Raises
        ------
        ConfigurationError
            If numbers of values do not fit the joints, or a value is out of range.
        """
        self.encoders()
        self.transducers()
        self.drives()
        if len(self.names_at_device()) != len(self.joints):
            raise ConfigurationError(
                f"parameter 'device_names' has {len(self.device_names)} values"
                f" for {len(self.joints)} joints"
            )


def _of_joints(kind: type[Kind], name: str, joints: int, values: Schema) -> tuple[Kind, ...]:
    """One object of a kind for each joint, from fields with one value or as many as joints."""
    fields: dict[str, Any] = dict(values)
    for field, given in fields.items():
        if len(given) not in (1, joints):
            raise ConfigurationError(
                f"parameter '{name}.{field}' has {len(given)} values for {joints} joints"
            )
    try:
        return tuple(
            kind(**{f: given[0] if len(given) == 1 else given[i] for f, given in fields.items()})
            for i in range(joints)
        )
    except ValidationError as error:
        raise ConfigurationError(f"{name}: {explain(error)}") from None
