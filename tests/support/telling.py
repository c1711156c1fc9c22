"""Progress reported by samples, so that it does not depend on the speed of the machine."""

import pytest

from armimp_estimation.node import ImpedanceEstimatorNode

EVERY = 250
"""Samples between two reports."""


def tell_by_samples(patch: pytest.MonkeyPatch) -> None:
    """Have estimators of this process report progress every `EVERY` samples as well.

    With its timer alone one may report nothing before a short trial is over.
    """
    on_samples = ImpedanceEstimatorNode._on_samples

    def counted(estimator: ImpedanceEstimatorNode, samples: int) -> None:
        before = estimator._recorded
        on_samples(estimator, samples)
        if samples // EVERY > before // EVERY:
            estimator._on_timer()

    patch.setattr(ImpedanceEstimatorNode, "_on_samples", counted)
