"""Parameters of the driver: the one place of their names, defaults and meaning."""

from __future__ import annotations

import math
from typing import Literal

from pydantic import Field, model_validator

from armimp_common.protection import ProtectionLimits
from armimp_common.schema import PositiveVector, Schema, Signs, Vector


class SensorParameters(Schema):
    """Calibration of one kind of sensor; each value is one for all joints or one for each."""

    resolution: PositiveVector
    """Resolution of the sensor (rad or N·m)."""
    zero: tuple[int, ...]
    """Count of the sensor at zero."""
    sign: Signs = (1,)
    """-1 where the sensor counts the other way than the joint, else 1."""
    gear: PositiveVector = (1.0,)
    """What the sensor sees for 1 rad or 1 N·m of the joint."""


class DriveParameters(Schema):
    """The drives; each value is one for all joints or one for each."""

    sign: Signs = (1,)
    """-1 where the drive turns the other way than the joint, else 1."""
    gear: PositiveVector = (1.0,)
    """Turns of the drive for one of the joint."""


class MockParameters(Schema):
    """The mock in the place of a device."""

    friction: int = Field(default=3, ge=0, le=3)
    """Friction level of the rig."""
    latency: int = Field(default=0, ge=0, le=100)
    """Periods by which commands act late."""
    dropout: float = Field(default=0.0, ge=0.0, lt=1.0)
    """Share of frames that are lost."""
    offset: Vector = (0.0,)
    """Offset of the transducers (N·m), one for all joints or each."""
    drift: Vector = (0.0,)
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

    @model_validator(mode="after")
    def _as_many_names(self) -> DriverParameters:
        if len(self.names_at_device()) != len(self.joints):
            raise ValueError(f"{len(self.device_names)} device_names for {len(self.joints)} joints")
        return self

    def names_at_device(self) -> tuple[str, ...]:
        """The device's name of each joint."""
        return self.device_names or self.joints
