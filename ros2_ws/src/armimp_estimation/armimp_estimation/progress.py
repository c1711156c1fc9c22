"""Running figures of the trial that is being recorded."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from armimp_common.cdr import JointStateDecoder
from armimp_common.contract import JOINT_STATES, PERTURBATION, TORQUE_SENSORS, VALUE_FIELD
from armimp_common.errors import DataError, MalformedMessageError
from armimp_estimation.scores import coherence
from armimp_estimation.spectra import WelchConfig
from armimp_estimation.trial import TrialAccumulator

_STREAMS = (PERTURBATION, JOINT_STATES, TORQUE_SENSORS)


class RunningCoherence:
    """Coherence of the segments recorded so far, for people who watch.

    Parameters
    ----------
    joint_names : tuple of str
        Names of the n joints.
    joint : int
        Perturbed joint, 0-based.
    rate : float
        Samples per second, Hz.
    planned : int
        Samples that the trial will have.
    """

    def __init__(
        self, joint_names: tuple[str, ...], joint: int, *, rate: float, planned: int
    ) -> None:
        self._joint = joint
        self._decoders = {
            topic: JointStateDecoder(joint_names, VALUE_FIELD[topic]) for topic in _STREAMS
        }
        self._accumulator = TrialAccumulator(
            len(joint_names), joint, rate, WelchConfig.for_samples(planned)
        )
        self._used = 0

    def update(self, messages: Mapping[str, list[bytes]]) -> tuple[float, float] | None:
        """Take in what has come since the last call.

        Parameters
        ----------
        messages : mapping of str to list of bytes
            All accepted messages of the trial so far, by topic.

        Returns
        -------
        (motion, torque) or None
            Band means of γ²(τΔ, θ_k) and γ²(τΔ, τ_k); None until there are two segments, and after
            a message that cannot be used (which the final account will name).
        """
        available = min(len(messages[topic]) for topic in _STREAMS)
        try:
            if available > self._used:
                blocks = [
                    self._decoders[topic].decode_many(messages[topic][self._used : available])[1]
                    for topic in _STREAMS
                ]
                self._accumulator.push(blocks[0], blocks[1], blocks[2])
                self._used = available
            if self._accumulator.segments < 2:
                return None
            trial = self._accumulator.result()
            k = self._joint
            motion = np.mean(coherence(trial.spectra, 0, trial.position_channel(k)))
            torque = np.mean(coherence(trial.spectra, 0, trial.torque_channel(k)))
        except (MalformedMessageError, DataError):
            return None
        return float(motion), float(torque)
