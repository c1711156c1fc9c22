"""What speaks against estimating a trial, in words."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armimp_common.topics import COMMANDS, NS_PER_S
from armimp_estimation.alignment.aligned_stream import AlignedStream
from armimp_estimation.alignment.stream_statistics import StreamCount
from armimp_estimation.alignment.trial_windows import TrialWindow


@dataclass(frozen=True, kw_only=True)
class TrialProblems:
    """Problems of a trial, each in one line; empty if there is none.

    Parameters
    ----------
    all : str
        Everything.
    lasting : str
        What remains when only the intact parts of the trial are used.
    """

    all: str = ""
    lasting: str = ""

    def and_also(self, lasting: str) -> "TrialProblems":
        """Return the same, with one more that gaps have no part in."""
        return TrialProblems(all=self.all or lasting, lasting=self.lasting or lasting)

    def and_commands(self, wrong: int, count: StreamCount, *, cut: bool) -> "TrialProblems":
        """Return the same, with what speaks against the commands.

        Parameters
        ----------
        wrong : int
            Commands that nobody asked for.
        count : StreamCount
            Their account. A recording without any is not judged by them.
        cut : bool
            Whether the recording may end between the messages of a tick.
        """
        if not count.received:
            return self
        if wrong:
            return self.and_also(
                f"{_samples(wrong)} of {COMMANDS} too many or out of turn: somebody else commanded"
            )
        if count.lost > cut:
            missing = f"{count.lost} commands fewer than samples"
            everything = _one_line(filter(None, (self.all, missing)))
            return TrialProblems(all=everything, lasting=self.lasting)
        return self


def find_problems(
    window: TrialWindow,
    kept: Mapping[str, AlignedStream],
    counts: Mapping[str, StreamCount],
    stamps: NDArray[np.int64],
    numbers: NDArray[np.int64],
    usable: NDArray[np.bool_],
) -> TrialProblems:
    """Find what speaks against estimating a trial.

    Parameters
    ----------
    window : TrialWindow
        What the trial was meant to be.
    kept : mapping of str to AlignedStream
        The streams with stamps, by topic.
    counts : mapping of str to StreamCount
        Their accounts.
    stamps, numbers : ndarray
        Stamps of all streams together within the trial, and the control period of each.
    usable : ndarray of bool, shape (span,)
        Whether each control period has a finite sample of every stream.
    """
    fault = " ".join(window.fault.split())
    if not usable.size:
        nothing = fault or "no samples of it were recorded"
        return TrialProblems(all=nothing, lasting=nothing)
    # What was recorded before an abort, or between missed samples, is intact.
    lasting = [fault] if fault and not (window.missed or window.aborted) else []
    close = np.flatnonzero(np.diff(numbers) == 0)
    if close.size:
        first, second = stamps[close[0]], stamps[close[0] + 1]
        lasting.append(
            f"{close.size} stamps do not agree, the first {second - first} ns from its neighbour"
        )
    gaps = [fault] if window.missed or window.aborted else []
    gaps += _gaps(kept, counts, usable.size)
    return TrialProblems(all=_one_line(lasting + gaps), lasting=_one_line(lasting))


def _gaps(
    kept: Mapping[str, AlignedStream], counts: Mapping[str, StreamCount], span: int
) -> list[str]:
    """What is missing, or not as it should be, in the streams."""
    parts: list[str] = []
    period = next(iter(kept.values())).period / NS_PER_S
    missing: dict[bytes, list[str]] = {}
    for topic, one in kept.items():
        missing.setdefault(one.present(span).tobytes(), []).append(topic)
    for holes, topics in missing.items():
        ticks = np.flatnonzero(~np.frombuffer(holes, np.bool_))
        if ticks.size:
            where = _missing(ticks, period)
            parts.append(f"{_samples(ticks.size)} of {_listed(topics)} {where}")
    for topic, one in kept.items():
        count = counts[topic]
        if one.stream.malformed and count.lost:
            parts.append(f"{one.stream.malformed} malformed of {topic}: {one.stream.defect}")
        ticks = np.flatnonzero(one.present(span) & ~one.finite(span))
        if ticks.size:
            verb = "is" if ticks.size == 1 else "are"
            parts.append(
                f"{_samples(ticks.size)} of {topic} {verb} not finite {_where(ticks, period)}"
            )
        ticks = np.flatnonzero(one.contradicted(span))
        if ticks.size:
            verb = "contradicts itself" if ticks.size == 1 else "contradict themselves"
            parts.append(f"{_samples(ticks.size)} of {topic} {verb} {_where(ticks, period)}")
        if count.duplicated:
            parts.append(f"{_samples(count.duplicated)} of {topic} came more than once")
        if count.reordered:
            parts.append(f"{_samples(count.reordered)} of {topic} came out of order")
    return parts


def _one_line(parts: Iterable[str]) -> str:
    return " ".join("; ".join(parts).split())


def _samples(count: int) -> str:
    return f"{count} sample{'' if count == 1 else 's'}"


def _missing(ticks: NDArray[np.intp], period: float) -> str:
    return f"{'is' if ticks.size == 1 else 'are'} missing {_where(ticks, period)}"


def _where(ticks: NDArray[np.intp], period: float) -> str:
    """When it was, in seconds from the start of the trial; the end is that of the last period."""
    first, last = int(ticks[0]), int(ticks[-1])
    if first == last:
        return f"at {first * period:.3f} s"
    places = 1 + int((np.diff(ticks) > 1).sum())
    several = f"in {places} places " if places > 1 else ""
    return f"{several}between {first * period:.3f} s and {(last + 1) * period:.3f} s"


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
