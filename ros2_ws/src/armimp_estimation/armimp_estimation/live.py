"""Coherence and column of the impedance from a trial that is still being recorded."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from armimp_common.errors import DataError
from armimp_common.status import TrialStatus
from armimp_common.topics import (
    JOINT_STATES,
    NS_PER_S,
    PERIOD_NS,
    PERTURBATION,
    TORQUE_SENSORS,
)
from armimp_estimation.alignment.streams import Stream, Streams
from armimp_estimation.estimators.lpm import FittedColumn, LpmFull
from armimp_estimation.record import TrialRecord
from armimp_estimation.scores import coherence
from armimp_estimation.spectra import SpectralAccumulator, WelchConfig
from armimp_estimation.trial import channels

_RATE = NS_PER_S / PERIOD_NS
_TOPICS = (PERTURBATION, JOINT_STATES, TORQUE_SENSORS)


class RunningTrial:
    """Estimates from the samples so far, for people who watch and for the stopping rule.

    Parameters
    ----------
    streams : Streams
        With those of the trial, which grow.
    status : TrialStatus
        Of the trial, from the beginning of its perturbation on.
    lpm : LpmFull, optional
        The estimator of the column.
    others : sequence of TrialRecord
        Trials before this one.
    """

    def __init__(
        self,
        streams: Streams,
        status: TrialStatus,
        *,
        lpm: LpmFull | None = None,
        others: Sequence[TrialRecord] = (),
    ) -> None:
        self._streams, self._status, self._others = streams, status, others
        self._start_ns = status.start_ns or 0
        self._lpm = lpm if lpm is not None else LpmFull()
        self._accumulator = SpectralAccumulator(
            2 * len(streams.joint_names) + 1, _RATE, WelchConfig.for_samples(status.ticks)
        )
        self._used = 0
        self._in_step = True

    def coherence(self) -> tuple[float, float] | None:
        """Band means of γ²(τΔ, θ_k) and γ²(τΔ, τ_k).

        There are none until there are two segments, and after a sample that cannot be used, which
        becomes a problem of the trial.
        """
        try:
            self._take()
            if self._accumulator.segments < 2:
                return None
            spectra = self._accumulator.result()
        except DataError:
            return None
        joint, n = self._status.joint, len(self._streams.joint_names)
        shown = 1 + joint, 1 + n + joint
        motion, torque = (float(np.mean(coherence(spectra, 0, one))) for one in shown)
        return motion, torque

    def column(self, samples: int | None = None) -> FittedColumn | None:
        """Column k of M, B and K with standard errors, as :meth:`LpmFull.column` gives it.

        It is of the first so many samples, by default of all that are there. There is none where
        they are too few, or one is missing or cannot be used.
        """
        try:
            self._take()
            count = self._used if samples is None else samples
            if not self._in_step or not 0 < count <= self._used:
                return None
            perturbation, position, torque = (
                stream.values[:, first : first + count] for first, stream in self._parts()
            )
            (first, _), *_ = self._parts()
            commands = self._streams.commands
            known = commands.count >= first + count and not commands.defect
            return self._lpm.column(
                TrialRecord(
                    trial=self._status.trial,
                    perturbed_joint=self._status.joint,
                    rate=_RATE,
                    joint_names=self._streams.joint_names,
                    perturbation=perturbation,
                    position=position,
                    torque=torque,
                    start_ns=self._start_ns,
                    seed=None,
                    command=commands.values[:, first : first + count] if known else None,
                ),
                self._others,
            )
        except DataError:
            return None

    def _parts(self) -> list[tuple[int, Stream]]:
        """Return perturbation, angles and torques, each with the place of its first sample."""
        streams = [self._streams.stamped[topic] for topic in _TOPICS]
        return [(int((one.stamps < self._start_ns).sum()), one) for one in streams]

    def _take(self) -> None:
        """Take in what has come since the last call."""
        self._streams.decode()
        parts = self._parts()
        if any(stream.malformed for _, stream in parts):
            raise DataError("a message cannot be decoded")
        available = min(stream.count - first for first, stream in parts)
        if available <= self._used:
            return
        new = slice(self._used, available)
        self._accumulator.push(
            channels(
                self._status.joint, *(stream.values[:, first:][:, new] for first, stream in parts)
            )
        )
        # Whether a sample is missing, doubled or out of order on any stream.
        leading, *others = (stream.stamps[first:] for first, stream in parts)
        steps = np.diff(leading[max(self._used - 1, 0) : available])
        self._in_step &= all(np.array_equal(leading[new], other[new]) for other in others)
        self._in_step &= bool((np.abs(steps - PERIOD_NS) < PERIOD_NS // 2).all())
        self._used = available
