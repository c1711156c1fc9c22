"""The two readings of a sample, which come as messages of their own: pairing by stamp."""

from __future__ import annotations

import math
from collections.abc import Sequence

Reading = tuple[float, ...]


class SamplePairs:
    """Readings of positions and torques that wait for the one with the same stamp."""

    def __init__(self) -> None:
        self._positions: dict[int, Reading] = {}
        self._torques: dict[int, Reading] = {}

    def with_position(self, stamp_ns: int, theta: Reading) -> Reading | None:
        """Take a position; the torque of the same stamp (ns), or None until that comes."""
        return _other(self._torques, self._positions, stamp_ns, theta)

    def with_torque(self, stamp_ns: int, tau_h: Reading) -> Reading | None:
        """Take a torque; the position of the same stamp (ns), or None until that comes."""
        return _other(self._positions, self._torques, stamp_ns, tau_h)


def _other(
    waiting: dict[int, Reading], own: dict[int, Reading], stamp_ns: int, values: Reading
) -> Reading | None:
    other = waiting.pop(stamp_ns, None)
    if other is None:
        own[stamp_ns] = values
    elif waiting or own:
        # Older readings without a partner are lost samples, which the experiment counts.
        for readings in (waiting, own):
            for old in [stamp for stamp in readings if stamp < stamp_ns]:
                del readings[old]
    return other


def first_bad(values: Sequence[float]) -> int | None:
    """Index of the first value that is not finite; None if there is none."""
    if math.isfinite(sum(values)):  # as it is with almost every reading
        return None
    return next((i for i, value in enumerate(values) if not math.isfinite(value)), None)
