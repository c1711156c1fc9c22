"""How a rig answers a constant torque, and how it lets go: the sign, the delay, the end.

Nothing is assumed of arm and friction but that they do the same again when they are pushed again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armimp_bringup.driver_check.samples import Push

_REST = 50
"""Samples at rest that make the baseline."""
_WINDOW = 120
"""Samples after the end that are looked at."""
_LEAST = 100
"""Samples after the end without which nothing can be said."""
_OVERLAP = 30
"""Samples of the window that lie after the end, wherever it is."""
_RAMPS = (1, 5, 10, 15, 20, 30, 40, 50, 60, 80)
"""Lengths of the straight way to zero that are tried (samples)."""
_SIGMAS = 5.0
_FIRST = 3


@dataclass(frozen=True, kw_only=True)
class Letting:
    """How the effect of a torque ended.

    Attributes
    ----------
    share : part of the torque that went, 1 if all of it
    delay : samples from ``off`` until it had gone
    """

    share: float
    delay: int


def displacement(push: Push) -> NDArray[np.float64]:
    """Mean change of each angle (n,), rad, in the second half of the push."""
    middle = (push.on + push.off) // 2
    return _mean(push.position, middle, push.off + 1) - _baseline(push.position, push.on)


def threshold(readings: NDArray[np.float64], on: int) -> NDArray[np.float64]:
    """Change (n,) of readings (n, N) that is no noise: five sigma at rest, and over one count."""
    rest = readings[:, max(on - _REST, 0) : on + 1]
    changes = np.abs(np.diff(np.sort(readings, axis=1), axis=1))
    count = np.array([np.min(row[row > 1e-9], initial=np.inf) for row in changes])
    # Unquantised readings have steps of any size; those of noise are below five sigma anyway.
    count = np.where(np.isfinite(count), count, 0.0)
    noise: NDArray[np.float64] = np.maximum(_SIGMAS * np.std(rest, axis=1), 1.5 * count)
    return noise


def first_effect(push: Push) -> tuple[int, float] | None:
    """When, and with what sign, the reading of torque answers; None if it doesn't.

    Returns
    -------
    samples : int
        From the sample which the first command answered to the first reading that has changed.
    change : float
        Mean change of this reading and the next two, N·m.
    """
    change = push.effort[push.joint] - _baseline(push.effort, push.on)[push.joint]
    bound = threshold(push.effort, push.on)[push.joint]
    seen = np.flatnonzero(np.abs(change[push.on + 1 : push.off + 1]) > bound)
    if not seen.size:
        return None
    first = push.on + 1 + int(seen[0])
    return first - push.on, float(np.mean(change[first : first + _FIRST]))


def letting(ended: Push, released: Push, held: Push) -> Letting | None:
    """Find when and how far the torque of a push went after ``off``, None if it had no effect.

    Parameters
    ----------
    ended : Push
        The push in question.
    released : Push
        The same, ended by a command of zero torque: what the end of it looks like.
    held : Push
        The same, but longer: how the readings would have gone on.

    What ``ended`` differs from ``held`` by after its end is compared with what ``released`` does,
    as if the torque had gone in a straight line: at every delay, of every length, by least squares.
    """
    length = min(_WINDOW, *(_room(push, ended) for push in (ended, held)))
    size = min(_WINDOW, *(_room(push, released) for push in (released, held)))
    if min(length, size) < _LEAST:
        return None
    for kind in ("effort", "position"):  # torque is the sharper witness, as it feels acceleration
        pattern = _difference(kind, held, released, size)
        bound = threshold(getattr(held, kind), held.on)[held.joint]
        if float(np.max(np.abs(pattern))) > bound:
            break
    else:
        return None
    rest = _difference(kind, held, ended, length)
    best, found = 0.0, Letting(share=0.0, delay=0)
    for ramp in _RAMPS:
        faded = np.convolve(pattern, np.full(ramp, 1.0 / ramp))[:size]
        for start in range(length - _OVERLAP):
            model = faded[: length - start]
            part = rest[start : start + model.size]
            product, power = float(model @ part), float(model @ model)
            share = min(product / power, 1.0) if power > 0.0 else 0.0  # not more than there was
            explained = share * (2.0 * product - share * power)
            if share > 0.0 and explained > best:
                best, found = explained, Letting(share=share, delay=start + ramp - 1)
    return found


def _room(push: Push, ended: Push) -> int:
    """Samples that a push has after the end of another one, both counted from their beginning."""
    return int(push.position.shape[1]) - (push.on + ended.off - ended.on + 1)


def _difference(kind: str, held: Push, ended: Push, length: int) -> NDArray[np.float64]:
    """What the readings of the pushed joint differ by after the end of ``ended``.

    They are compared at the last sample before, as friction leaves each push at another angle.
    """
    found = []
    for push in (held, ended):
        readings: NDArray[np.float64] = getattr(push, kind)[push.joint]
        first = push.on + ended.off - ended.on + 1
        found.append(readings[first : first + length] - np.mean(readings[first - 5 : first]))
    difference: NDArray[np.float64] = found[0] - found[1]
    return difference


def _baseline(readings: NDArray[np.float64], on: int) -> NDArray[np.float64]:
    return _mean(readings, max(on - _REST, 0), on + 1)


def _mean(readings: NDArray[np.float64], first: int, end: int) -> NDArray[np.float64]:
    mean: NDArray[np.float64] = np.mean(readings[:, first:end], axis=1)
    return mean
