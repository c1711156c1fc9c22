"""Parameters of the driver: the one place of their names, defaults and meaning."""

from __future__ import annotations

import math
from typing import Literal

from pydantic import Field

from armimp_common.errors import ConfigurationError
from armimp_common.schema import Schema
from armimp_driver_template.protection import ProtectionLimits


class SensorParameters(Schema):
    """Calibration of one kind of sensor."""

    resolution: float = Field(description="rad or N·m per count")
    zero: tuple[int, ...] = Field(description="count of each joint at zero")


class LimitParameters(Schema):
    """Limits of the driver itself, wider than those of the controller."""

    position: float = Field(default=2.0 * math.pi, gt=0.0, description="largest angle (rad)")
    velocity: float = Field(default=20.0, gt=0.0, description="largest velocity (rad/s)")
    torque: float = Field(default=100.0, gt=0.0, description="largest command (N·m)")

    def limits(self) -> ProtectionLimits:
        """The limits as a value."""
        return ProtectionLimits(position=self.position, velocity=self.velocity, torque=self.torque)


class MockParameters(Schema):
    """The mock in the place of a device."""

    friction: int = Field(default=3, ge=0, le=3, description="friction level of the rig")
    latency: int = Field(default=0, ge=0, le=100, description="periods until a command acts")
    dropout: float = Field(default=0.0, ge=0.0, lt=1.0, description="share of frames that are lost")
    drift: float = Field(default=0.0, description="drift of the transducers (N·m/s)")
    seed: int = Field(default=1, ge=0, description="seed of the dropouts")


class DriverParameters(Schema):
    """All parameters of the driver."""

    joints: tuple[str, ...] = Field(
        default=("shoulder", "elbow"), description="names of the joints, in the order of commands"
    )
    mode: Literal["lockstep", "realtime"] = Field(
        default="realtime", description="lockstep: time waits for commands, with the mock only"
    )
    encoder: SensorParameters = SensorParameters(
        resolution=2.0 * math.pi / 51200, zero=(60000, 60000)
    )
    transducer: SensorParameters = SensorParameters(resolution=0.02, zero=(1250, -400))
    limits: LimitParameters = LimitParameters()
    mock: MockParameters = MockParameters()

    def check(self) -> None:
        """Check what concerns several parameters.

        Raises
        ------
        ConfigurationError
            If there is not one zero for each joint.
        """
        for name, sensor in (("encoder", self.encoder), ("transducer", self.transducer)):
            if len(sensor.zero) != len(self.joints):
                raise ConfigurationError(
                    f"parameter '{name}.zero' has {len(sensor.zero)} values"
                    f" for {len(self.joints)} joints"
                )
