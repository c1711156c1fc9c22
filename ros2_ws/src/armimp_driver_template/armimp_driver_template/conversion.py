"""From raw counts to radians and newton metres."""

from __future__ import annotations

from collections.abc import Sequence

BITS = 16
"""Width of the encoders' counters."""


class Encoders:
    """Angles from counters that wrap.

    Parameters
    ----------
    resolution : rad per count; negative where an encoder counts against the direction of the joint
    zero : count of each joint at angle zero
    """

    def __init__(self, resolution: float, zero: Sequence[int]) -> None:
        self._resolution, self._zero = resolution, tuple(zero)
        self._counts: list[int] | None = None

    def angles(self, raw: Sequence[int]) -> tuple[float, ...]:
        """Return angles (n,), rad; the first ones lie within half the counters' range of zero.

        Counters wrap, angles do not: a change by more than half the range is a wrap.
        """
        before = self._zero if self._counts is None else self._counts
        self._counts = [old + _wrapped(new - old) for old, new in zip(before, raw, strict=True)]
        return tuple(
            (count - zero) * self._resolution
            for count, zero in zip(self._counts, self._zero, strict=True)
        )


class Transducers:
    """Torques from the counts of transducers.

    Parameters
    ----------
    resolution : N·m per count
    zero : count of each joint without load, as measured before somebody is strapped in
    """

    def __init__(self, resolution: float, zero: Sequence[int]) -> None:
        self._resolution, self._zero = resolution, tuple(zero)

    def torques(self, raw: Sequence[int]) -> tuple[float, ...]:
        """Return torques (n,), N·m."""
        pairs = zip(raw, self._zero, strict=True)
        return tuple((count - zero) * self._resolution for count, zero in pairs)


def _wrapped(change: int) -> int:
    half = 1 << (BITS - 1)
    return (change + half) % (2 * half) - half
