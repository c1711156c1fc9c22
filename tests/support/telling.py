"""Progress that comes by samples, so that it does not depend on how quick the machine is."""

import pytest

from armimp_estimation.node import ImpedanceEstimatorNode

EVERY = 250
"""Samples."""


def tell_by_samples(patch: pytest.MonkeyPatch) -> None:
    """Have estimators of this process tell their progress every so many samples, too.

    By its timer alone one may have told nothing before a short trial is over.
    """
    on_samples = ImpedanceEstimatorNode._on_samples

    def counted(estimator: ImpedanceEstimatorNode, samples: int) -> None:
        before = estimator._recorded
        on_samples(estimator, samples)
        if samples // EVERY > before // EVERY:
            estimator._on_timer()

    patch.setattr(ImpedanceEstimatorNode, "_on_samples", counted)
