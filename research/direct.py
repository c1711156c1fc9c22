"""Baseline that ignores the feedback loop and regresses measured torque on measured angle.

In the trial that perturbs joint k, ``Z_ik = G_{θk τi}/G_{θk θk}``. That would be right if the angle
were an exogenous input. But a voluntary torque d is part of the measured torque and, through the
loop, also moves the joints, so ``G_{θk d}`` is not zero. Where d outweighs the perturbation, the
estimate tends to the impedance of the controller with opposite sign, and averaging does not help.
Encoder noise biases it, too. This estimator serves for comparison only.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from armimp_common.errors import DataError
from armimp_estimation.estimators.estimate import ImpedanceEstimate
from armimp_estimation.estimators.welch import WelchSiso, matrix_estimate
from armimp_estimation.frf import frf_matrix, noise_gain, order_trials, unexplained
from armimp_estimation.trial import TrialData


@dataclass(frozen=True, kw_only=True)
class Direct:
    """``Z_ik = G_{θk τi}/G_{θk θk}`` by averaged spectra, as if there were no loop."""

    name: str = "direct"

    def estimate(self, trials: Sequence[TrialData]) -> ImpedanceEstimate:
        """Estimate the whole matrix from n trials, one for each joint, in any order.

        The random error of a column has the variance ``G_ee / ((n_d - 1) G_θθ)`` with
        ``e = τ_i - Z_ik θ_k``. The difference from `welch_siso` shows the bias, and is added as a
        systematic standard error; it vanishes if the perturbation is the angle itself.

        Raises
        ------
        DataError
            If a joint has no trial, there are too few segments, or a joint does not move.
        """
        ordered = order_trials(trials)
        columns, disturbances = [], []
        for trial in ordered:
            angle, torque = trial.position_channel(trial.joint), trial.torque_channel(0)
            motion = trial.spectra.power(angle)
            if not (motion > 0.0).all():
                still = trial.f[~(motion > 0.0)][0]
                raise DataError(f"joint {trial.joint + 1} does not move at {still:.4g} Hz")
            columns.append(trial.spectra.matrix[angle, torque:] / motion)
            gain = noise_gain(trial) * trial.input_power / motion
            disturbances.append(gain * unexplained(trial.spectra, angle, torque))
        frf = frf_matrix(ordered)
        inverse = np.eye(len(ordered), dtype=np.complex128)[:, :, None] * np.ones(frf.f.size)
        impedance = np.stack(columns, axis=1)
        bias = impedance - WelchSiso().estimate(ordered).Z
        disturbance = np.stack(disturbances)
        return matrix_estimate(self.name, ordered, frf, impedance, disturbance, inverse, (bias,))
