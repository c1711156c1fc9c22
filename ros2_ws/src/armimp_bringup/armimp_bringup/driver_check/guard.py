"""The checker's own limit of motion: what it commands must not move a rig far."""

from __future__ import annotations

from collections.abc import Sequence

from armimp_common.cdr import JointStateDecoder
from armimp_common.errors import MalformedMessageError


class MotionGuard:
    """Looks at every sample of the angles while torque may be commanded.

    Parameters
    ----------
    joints : names
    most : how far each joint may go from where it was at the first look (rad)

    Attributes
    ----------
    largest : how far one has gone so far (rad)
    reason : why there must not be any torque any more; empty while all is well
    """

    def __init__(self, joints: Sequence[str], most: float) -> None:
        self._joints, self._most = tuple(joints), most
        self._decode = JointStateDecoder(joints, "position").decode
        self._first: tuple[float, ...] | None = None
        self.largest = 0.0
        self.reason = ""

    def look(self, data: bytes) -> bool:
        """Look at a message of ``joint_states``; tell whether torque may be commanded."""
        try:
            _, angles = self._decode(data)
        except MalformedMessageError as error:
            self.reason = self.reason or f"an angle cannot be read: {error}"
            return False
        if self._first is None:
            self._first = angles
        for name, start, angle in zip(self._joints, self._first, angles, strict=True):
            moved = abs(angle - start)
            # Written so that NaN fails.
            if not moved <= self._most:
                self.reason = self.reason or (
                    f"{name} went {moved:.3g} rad from where it was: torque taken away"
                )
            else:
                self.largest = max(self.largest, moved)
        return not self.reason
