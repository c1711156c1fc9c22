"""Controller settings that make no sense are refused in one line with the offending value."""

from __future__ import annotations

import numpy as np

from armimp_control.laws.imbic import ImbicConfig


def _config() -> ImbicConfig:
    return ImbicConfig(
        target_posture=np.zeros(2),
        target_inertia=np.array([0.2, 0.1]),
        target_damping=np.array([2.0, 1.0]),
        target_stiffness=np.array([10.0, 10.0]),
        model_inertia=0.1 * np.eye(2),
    )


def test_defaults_are_those_of_the_design() -> None:
    config = _config()
    assert (config.lock_frequency, config.lock_damping_ratio) == (100.0, 1.0)
    assert (config.gamma, config.period) == (100.0, 1e-3)
    assert (config.lock_approach, config.lock_dither) == (0.05, 0.0)
