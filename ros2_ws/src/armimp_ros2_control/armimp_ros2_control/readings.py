"""How joint states of ros2_control are read: which joints, which signs, and which stamps."""

from __future__ import annotations

from collections.abc import Sequence

from armimp_common.cdr import JointStateDecoder
from armimp_common.errors import MalformedMessageError
from armimp_common.schema import each
from armimp_common.topics import PERIOD_NS, clock_step
from armimp_ros2_control.parameters import BridgeParameters

_CROWD, _THIN = 5.0, 50.0
"""Limits of two counts, of surplus and of missing samples; each normal one lowers them by 0.1."""
_LONGEST = 10
"""Most periods from one sample to the next; if the clock is set, stamps can jump by any number."""
_SLACK, _TOLERANCE = 5, 1e-3
"""Allowed deviation of stamps from one period per sample: in periods, plus a share of all."""


class Readings:
    """Picks angles and torques of the configured joints from joint states that have both.

    Parameters
    ----------
    parameters : BridgeParameters

    Raises
    ------
    ConfigurationError
        If the number of directions or of signs is neither 1 nor n.
    """

    def __init__(self, parameters: BridgeParameters) -> None:
        names, n = parameters.names_there(), len(parameters.joints)
        self._angles = JointStateDecoder(names, "position", others=True)
        self._torques = JointStateDecoder(names, "effort", others=True)
        directions = each("directions", parameters.directions, n)
        signs = directions * each("torque_signs", parameters.torque_signs, n)
        self._directions, self._signs = tuple(map(float, directions)), tuple(map(float, signs))

    def decode(self, data: bytes) -> tuple[int, tuple[float, ...], tuple[float, ...]]:
        """Return stamp (ns), angles (n,) in rad, and torques (n,) in N·m; NaN stays NaN.

        Raises
        ------
        MalformedMessageError
            If a joint is missing or duplicate, or the numbers of positions and efforts are not that
            of the joints.
        """
        stamp_ns, angles = self._angles.decode(data)
        _, torques = self._torques.decode(data)
        return stamp_ns, _signed(angles, self._directions), _signed(torques, self._signs)

    def commands(self, torque: Sequence[float]) -> tuple[float, ...]:
        """Return the efforts (n,) to command in ros2_control for torques (n,), N·m."""
        return _signed(torque, self._directions)


class Stamps:
    """Checks that samples are stamped once in every period, and leaves out surplus ones.

    Samples keep their stamps, jitter included. Only a sample stamped at most half a period after
    the last one is left out: rounded to whole periods, as all nodes do, it would be the same
    sample again. If that leaves a gap, it shows as a lost sample.

    Attributes
    ----------
    left_out : samples that were not passed on
    lost : samples that never came
    """

    def __init__(self) -> None:
        self._first = self._last = 0
        self._ticks = -1
        self._crowd = self._thin = 0.0
        self.left_out = self.lost = 0

    def step(self, stamp_ns: int) -> int:
        """Return the number of periods since the last sample; 0 if this one is to be left out.

        Raises
        ------
        MalformedMessageError
            If stamps stand still or go back, or samples do not come once in a period.
        """
        if self._ticks < 0:
            self._ticks, self._first, self._last = 0, stamp_ns, stamp_ns
            return 1
        if jump := clock_step(self._last, stamp_ns):
            raise MalformedMessageError(jump)
        ahead = stamp_ns - self._last
        if ahead <= 0:
            raise MalformedMessageError(
                f"the stamp {stamp_ns} ns does not come after the last one, {self._last} ns"
            )
        # Rounded; a step of exactly half a period is none.
        steps = (ahead - 1 + PERIOD_NS // 2) // PERIOD_NS
        self._crowd = self._crowd + 1.0 if steps == 0 else max(self._crowd - 0.1, 0.0)
        self._thin = max(self._thin + steps - 1 if steps > 1 else self._thin - 0.1, 0.0)
        if steps:
            self._last = stamp_ns
            self._ticks += steps
            self.lost += steps - 1
        else:
            self.left_out += 1
        elapsed = (self._last - self._first) / PERIOD_NS
        drift = abs(elapsed - self._ticks)
        thin = steps > _LONGEST or self._thin > _THIN
        if thin or self._crowd > _CROWD or drift > _SLACK + _TOLERANCE * self._ticks:
            raise MalformedMessageError(
                f"samples do not come once a millisecond (the last one after {ahead / 1e6:.3g} ms):"
                " update_rate of the controller manager has to be 1000"
            )
        return steps


def _signed(values: Sequence[float], signs: Sequence[float]) -> tuple[float, ...]:
    return tuple(value * sign for value, sign in zip(values, signs, strict=True))
