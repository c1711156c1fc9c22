"""Parameters of the bridge: the one place of their names, defaults and meaning."""

from __future__ import annotations

from typing import Literal

from armimp_common.errors import ConfigurationError
from armimp_common.protection import ProtectionLimits
from armimp_common.realtime import SchedulingParameters
from armimp_common.schema import Schema


class BridgeParameters(Schema):
    """All parameters of the bridge."""

    joints: tuple[str, ...] = ("shoulder", "elbow")
    """Names of the joints, in the order of commands."""
    mode: Literal["realtime"] = "realtime"
    """ros2_control does not wait for commands."""
    names: tuple[str, ...] = ()
    """Names of the joints in ros2_control, in the same order; empty: the same names."""
    directions: tuple[int, ...] = ()
    """1, or -1 for a joint that counts the other way in ros2_control."""
    torque_signs: tuple[int, ...] = ()
    """1, or -1 where the effort is the torque of the arm on the robot."""
    limits: ProtectionLimits = ProtectionLimits()
    realtime: SchedulingParameters = SchedulingParameters()

    def checked(self) -> BridgeParameters:
        """Return the same with nothing left empty.

        Raises
        ------
        ConfigurationError
            If there is not one value for each joint, or a sign is neither 1 nor −1.
        """
        count = len(self.joints)
        ones = (1,) * count
        full = self.model_copy(
            update={
                "names": self.names or self.joints,
                "directions": self.directions or ones,
                "torque_signs": self.torque_signs or ones,
            }
        )
        for name in ("names", "directions", "torque_signs"):
            values = getattr(full, name)
            if len(values) != count:
                raise ConfigurationError(
                    f"parameter '{name}' has {len(values)} values for {count} joints"
                )
            if name != "names" and any(value not in (1, -1) for value in values):
                raise ConfigurationError(f"parameter '{name}' is not made of 1 and -1: {values}")
        return full
