"""Running figures of the trial that is being recorded."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from armimp_common.errors import DataError
from armimp_common.topics import JOINT_STATES, PERIOD_NS, PERTURBATION, TORQUE_SENSORS
from armimp_estimation.alignment.streams import Streams
from armimp_estimation.estimators.lpm import FittedColumn, LpmFull
from armimp_estimation.record import TrialRecord
from armimp_estimation.scores import coherence
from armimp_estimation.spectra import WelchConfig
from armimp_estimation.trial import TrialAccumulator


class RunningTrial:
    """What the samples recorded so far tell, for people who watch and to know when it is enough.

    Parameters
    ----------
    streams : Streams
        Those of the trial, which grow.
    joint : int
        Perturbed joint, 0-based.
    rate : float
        Samples per second, Hz.
    planned : int
        Samples that the trial will have.
    trial : int
        Its number, 1-based.
    lpm : LpmFull, optional
        The estimator of the column.
    others : sequence of TrialRecord
        Trials before this one.
    """

    def __init__(
        self,
        streams: Streams,
        joint: int,
        *,
        rate: float,
        planned: int,
        trial: int = 1,
        lpm: LpmFull | None = None,
        others: Sequence[TrialRecord] = (),
    ) -> None:
        self._streams, self._others = streams, others
        self._joint, self._rate, self._trial = joint, rate, trial
        self._lpm = lpm if lpm is not None else LpmFull()
        self._accumulator = TrialAccumulator(
            len(streams.joint_names), joint, rate, WelchConfig.for_samples(planned)
        )
        self._used = 0
        self._in_step = True

    def coherence(self) -> tuple[float, float] | None:
        """Band means of γ²(τΔ, θ_k) and γ²(τΔ, τ_k).

        Returns
        -------
        (motion, torque) or None
            None until there are two segments, and after a sample that cannot be used (which the
            final account will name).
        """
        try:
            self._take()
            if self._accumulator.segments < 2:
                return None
            trial = self._accumulator.result()
        except DataError:
            return None
        channels = trial.position_channel(self._joint), trial.torque_channel(self._joint)
        motion, torque = (float(np.mean(coherence(trial.spectra, 0, one))) for one in channels)
        return motion, torque

    def column(self, samples: int | None = None) -> FittedColumn | None:
        """Column k of M, B and K with standard errors, as :meth:`LpmFull.column` gives it.

        Parameters
        ----------
        samples : int, optional
            How many samples to use, from the first on; by default all that are there.

        Returns
        -------
        FittedColumn or None
            None where the samples are too few, or one is missing or cannot be used.
        """
        try:
            self._take()
            count = self._used if samples is None else samples
            if not self._in_step or not 0 < count <= self._used:
                return None
            streams, commands = self._streams, self._streams.commands
            known = commands.count >= count and not commands.defect
            return self._lpm.column(
                TrialRecord(
                    trial=self._trial,
                    perturbed_joint=self._joint,
                    rate=self._rate,
                    joint_names=streams.joint_names,
                    perturbation=streams.stamped[PERTURBATION].values[:, :count],
                    position=streams.stamped[JOINT_STATES].values[:, :count],
                    torque=streams.stamped[TORQUE_SENSORS].values[:, :count],
                    start_ns=0,
                    seed=None,
                    command=commands.values[:, :count] if known else None,
                ),
                self._others,
            )
        except DataError:
            return None

    def _take(self) -> None:
        """Take in what has come since the last call."""
        stamped = self._streams.decode().stamped
        streams = [stamped[topic] for topic in (PERTURBATION, JOINT_STATES, TORQUE_SENSORS)]
        available = min(stream.count for stream in streams)
        new = slice(self._used, available)
        if any(stream.malformed for stream in streams):
            raise DataError("a message cannot be decoded")
        if available <= self._used:
            return
        self._accumulator.push(*(stream.values[:, new] for stream in streams))
        # Whether a sample is missing, doubled or out of order on any stream.
        first, *others = (stream.stamps for stream in streams)
        steps = np.diff(first[max(self._used - 1, 0) : available])
        self._in_step &= all(np.array_equal(first[new], other[new]) for other in others)
        self._in_step &= bool((np.abs(steps - PERIOD_NS) < PERIOD_NS // 2).all())
        self._used = available
