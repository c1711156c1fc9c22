"""From raw counts to radians and newton metres, and back; from the device's joints to one's own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, TypeVar

from pydantic import Field

from armimp_common.errors import ConfigurationError
from armimp_common.schema import Schema

BITS = 16
"""Width of the encoders' counters."""

Item = TypeVar("Item")


class Calibration(Schema):
    """One sensor of one joint: ``value = sign · (count − zero) · resolution / gear``."""

    resolution: float = Field(gt=0.0)
    """In rad or N·m per count, on the side of the sensor."""
    zero: int = 0
    """Count at zero."""
    sign: Literal[1, -1] = 1
    """1, or −1 where the sensor counts against the direction of the joint."""
    gear: float = Field(default=1.0, gt=0.0)
    """What the sensor sees for 1 rad or 1 N·m of the joint: turns of an encoder's shaft for one
    turn of the joint; for a transducer the share of the torque that passes it, or its gain."""

    def value(self, count: int) -> float:
        """Value of the joint, rad or N·m."""
        return self.sign * (count - self.zero) * self.resolution / self.gear

    def count(self, value: float) -> int:
        """Nearest count, without a wrap: what the sensor shows."""
        return self.sign * round(value * self.gear / self.resolution) + self.zero


class Drive(Schema):
    """One drive: its torque is ``sign · τ / gear`` for a torque τ of the joint."""

    sign: Literal[1, -1] = 1
    """1, or −1 where it turns against the direction of the joint."""
    gear: float = Field(default=1.0, gt=0.0)
    """Its turns for one turn of the joint."""

    def torque(self, joint: float) -> float:
        """Torque of the drive for that of the joint, N·m."""
        return self.sign * joint / self.gear

    def joint(self, torque: float) -> float:
        """Torque of the joint for that of the drive, N·m."""
        return self.sign * torque * self.gear


class Encoders:
    """Angles from counters that wrap.

    Parameters
    ----------
    calibration : of each joint
    """

    def __init__(self, calibration: Sequence[Calibration]) -> None:
        self._calibration = tuple(calibration)
        self._counts: list[int] | None = None

    def angles(self, raw: Sequence[int]) -> tuple[float, ...]:
        """Return angles (n,), rad; the first ones lie within half the counters' range of zero.

        Counters wrap, angles do not: a change by more than half the range is a wrap.
        """
        zero = [one.zero for one in self._calibration]
        before = zero if self._counts is None else self._counts
        self._counts = [old + _wrapped(new - old) for old, new in zip(before, raw, strict=True)]
        return _values(self._calibration, self._counts)


class Transducers:
    """Torques from the counts of transducers.

    Parameters
    ----------
    calibration : of each joint; the zero is the count without load, as measured before somebody is
        strapped in
    """

    def __init__(self, calibration: Sequence[Calibration]) -> None:
        self._calibration = tuple(calibration)

    def torques(self, raw: Sequence[int]) -> tuple[float, ...]:
        """Return torques (n,), N·m."""
        return _values(self._calibration, raw)


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
        """The other way round."""
        return tuple(values[place] for place in self._to)


def _values(calibration: Sequence[Calibration], counts: Sequence[int]) -> tuple[float, ...]:
    return tuple(one.value(count) for one, count in zip(calibration, counts, strict=True))


def _wrapped(change: int) -> int:
    half = 1 << (BITS - 1)
    return (change + half) % (2 * half) - half
