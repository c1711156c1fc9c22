"""Baseline that ignores the loop: from the measured angle straight to the measured torque.

In the trial that perturbs joint k, ``Z_ik = G_{θk τi}/G_{θk θk}``. That would be right if the angle
were an input of its own. But a voluntary torque d moves the joints through the loop, so that the
angle is correlated with the disturbance of the torque it is to explain: ``G_{θk d}`` is not zero.
Where d outweighs the perturbation, the estimate tends to the impedance of the controller, with
opposite sign. Averaging does not help. Noise of the encoder biases it, too. It is here to compare.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from armimp_common.errors import DataError
from armimp_estimation.estimators.estimate import ImpedanceColumn, ImpedanceEstimate
from armimp_estimation.estimators.welch import estimate_by_columns, impedance_column
from armimp_estimation.frf import noise_gain, order_trials
from armimp_estimation.trial import TrialData, TrialSpectra

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True, kw_only=True)
class Direct:
    """``Z_ik = G_{θk τi}/G_{θk θk}`` by averaged spectra, as if there were no loop."""

    name: str = "direct"

    def column(self, trial: TrialSpectra) -> ImpedanceColumn:
        """Column k from the trial of joint k.

        The variance is ``G_ee / ((n_d - 1) G_θθ)`` with ``e = τ_i - Z_ik θ_k``. It describes the
        scatter, not the bias: both may be far apart.

        Raises
        ------
        DataError
            If there are fewer than two segments, or joint k does not move.
        """
        k = trial.perturbed_joint
        channel = trial.position_channel(k)
        motion = trial.spectra.power(channel)
        if not (motion > 0.0).all():
            still = trial.f[~(motion > 0.0)][0]
            raise DataError(f"joint {k + 1} does not move at {still:.4g} Hz")
        torques = slice(trial.torque_channel(0), trial.torque_channel(trial.joints))
        impedance: ComplexArray = trial.spectra.matrix[channel, torques] / motion
        gain = noise_gain(trial) * trial.input_power / motion
        return impedance_column(trial, impedance, gain)

    def estimate(self, trials: Sequence[TrialData]) -> ImpedanceEstimate:
        """Whole matrix from n trials in any order, one for each joint.

        Raises
        ------
        DataError
            If a joint has no trial, or as :meth:`column`.
        """
        estimate = estimate_by_columns(self.name, trials, self.column)
        n = estimate.joints
        left = [self._unexplained(trial.spectra) for trial in order_trials(trials)]
        inverse = np.eye(n, dtype=np.complex128)[:, :, None] * np.ones(estimate.f.size)
        return replace(estimate, disturbance=np.stack(left), inverse=inverse)

    def _unexplained(self, trial: TrialSpectra) -> ComplexArray:
        """Covariance of a column, shape (n, n, n_freq): that of torques without the motion."""
        angle = trial.position_channel(trial.perturbed_joint)
        first = trial.torque_channel(0)
        matrix, motion = trial.spectra.matrix, trial.spectra.power(angle)
        crossed = matrix[angle, first:]
        left = (
            np.swapaxes(matrix[first:, first:], 0, 1)
            - crossed[:, None] * np.conj(crossed[None]) / motion
        )
        covariance: ComplexArray = noise_gain(trial) * trial.input_power / motion * left
        return covariance
