"""Conversion of raw counts to radians and newton metres and back, and of the order of joints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from armimp_common.errors import ConfigurationError
from armimp_common.schema import each
from armimp_driver_template.parameters import DriveParameters, SensorParameters

BITS = 16
"""Width of the encoders' counters."""

Item = TypeVar("Item")


class Sensors:
    """One kind of sensor, by joint: ``value = sign · (count − zero) · resolution / gear``.

    ConfigurationError if there are not as many values as joints; ``name`` is in the message.
    """

    def __init__(self, name: str, parameters: SensorParameters, joints: int) -> None:
        self._zero, self._sign, self._resolution, self._gear = (
            each(f"{name}.{field}", getattr(parameters, field), joints)
            for field in ("zero", "sign", "resolution", "gear")
        )

    @property
    def count(self) -> float:
        """Size of one count at the joint, rad or N·m; 0 if joints differ."""
        found = set((self._resolution / self._gear).tolist())
        return found.pop() if len(found) == 1 else 0.0

    def values(self, counts: Sequence[int] | NDArray[np.int64]) -> tuple[float, ...]:
        """Values of the joints (n,), rad or N·m."""
        values = self._sign * (np.array(counts) - self._zero) * self._resolution / self._gear
        return tuple(values.tolist())

    def counts(self, values: Sequence[float]) -> tuple[int, ...]:
        """Counts (n,) that the sensors show for these values, rounded but not wrapped."""
        steps = np.rint(np.array(values) * self._gear / self._resolution)
        return tuple((self._sign * steps + self._zero).astype(np.int64).tolist())


class Encoders(Sensors):
    """Angles from counters that wrap."""

    def __init__(self, name: str, parameters: SensorParameters, joints: int) -> None:
        super().__init__(name, parameters, joints)
        self.begin()

    def begin(self) -> None:
        """Forget the last angles."""
        self._unwrapped = self._zero

    def angles(self, raw: Sequence[int]) -> tuple[float, ...]:
        """Return angles (n,), rad; the first ones lie within half the counters' range of zero.

        Counters wrap, angles do not: a change by more than half the range is a wrap.
        """
        half = 1 << (BITS - 1)
        change = (np.array(raw) - self._unwrapped + half) % (2 * half) - half
        self._unwrapped = self._unwrapped + change
        return self.values(self._unwrapped)


class Drives:
    """The drives, by joint: the torque of a drive is ``sign · τ / gear`` for τ at its joint.

    ConfigurationError if there are not as many values as joints.
    """

    def __init__(self, parameters: DriveParameters, joints: int) -> None:
        self._sign, self._gear = (
            each(f"drive.{field}", getattr(parameters, field), joints) for field in ("sign", "gear")
        )

    def of_drives(self, torques: Sequence[float]) -> tuple[float, ...]:
        """Torques of the drives (n,) for those of the joints, N·m."""
        return tuple((self._sign * np.array(torques) / self._gear).tolist())

    def of_joints(self, torques: Sequence[float]) -> tuple[float, ...]:
        """Torques of the joints (n,) for those of the drives, N·m."""
        return tuple((self._sign * np.array(torques) * self._gear).tolist())


class Wiring:
    """Which value of the device belongs to which joint.

    Parameters
    ----------
    device : names at the device, in the order of its frames
    joints : the device's name of each joint, in the order of joints

    Raises
    ------
    ConfigurationError
        If a joint has no counterpart, or two have the same.
    """

    def __init__(self, device: Sequence[str], joints: Sequence[str]) -> None:
        if sorted(device) != sorted(joints) or len(set(joints)) != len(joints):
            raise ConfigurationError(
                f"parameter 'device_names' is {', '.join(joints)}; the device has "
                f"{', '.join(device)}"
            )
        self._from = [list(device).index(name) for name in joints]
        self._to = [list(joints).index(name) for name in device]

    def to_joints(self, values: Sequence[Item]) -> tuple[Item, ...]:
        """Values in the order of the joints, from those in the order of the device."""
        return tuple(values[place] for place in self._from)

    def to_device(self, values: Sequence[Item]) -> tuple[Item, ...]:
        """Values in the order of the device, from those in the order of the joints."""
        return tuple(values[place] for place in self._to)
