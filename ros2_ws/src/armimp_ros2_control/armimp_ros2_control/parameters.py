"""Parameters of the bridge: the one place of their names, defaults and meaning."""

from __future__ import annotations

from typing import Literal

from pydantic import model_validator

from armimp_common.protection import ProtectionLimits
from armimp_common.realtime import SchedulingParameters
from armimp_common.schema import Schema, Signs


class BridgeParameters(Schema):
    """All parameters of the bridge."""

    joints: tuple[str, ...] = ("shoulder", "elbow")
    """Names of the joints, in the order of commands."""
    mode: Literal["realtime"] = "realtime"
    """Always realtime, as ros2_control does not wait for commands."""
    names: tuple[str, ...] = ()
    """Names of the joints in ros2_control, in the same order; empty: the same names."""
    directions: Signs = (1,)
    """1, or -1 for a joint that counts the other way in ros2_control; one value or one for each."""
    torque_signs: Signs = (1,)
    """1, or -1 where the effort is the torque of the arm on the robot; one value or one for each.
    """
    limits: ProtectionLimits = ProtectionLimits()
    realtime: SchedulingParameters = SchedulingParameters()

    @model_validator(mode="after")
    def _as_many_names(self) -> BridgeParameters:
        if len(self.names_there()) != len(self.joints):
            raise ValueError(f"{len(self.names)} names for {len(self.joints)} joints")
        return self

    def names_there(self) -> tuple[str, ...]:
        """The name of each joint in ros2_control."""
        return self.names or self.joints
