"""Presets of the controller: the paper's Table III, and what the design assumes."""

from __future__ import annotations

import numpy as np
import pytest

from armimp_common.errors import ConfigurationError
from armimp_control import presets
from support.laws import preset_law

ROBOT = np.array([[0.3543, 0.1909], [0.1909, 0.1800]])
POSTURE = np.array([1.0945, 1.3484])


@pytest.mark.parametrize(("level", "peak"), [(1, (3.0, 1.8)), (2, (6.0, 3.6)), (3, (9.0, 5.4))])
def test_peaks_are_those_of_table_three(level: int, peak: tuple[float, ...]) -> None:
    config = presets.perturbation(level, 2)
    assert config.peak == pytest.approx(peak, rel=1e-15)
    assert (config.cutoff, config.order) == (15.0, 8)


@pytest.mark.parametrize("joints", [0, 8])
def test_number_of_joints_without_a_preset_is_refused(joints: int) -> None:
    with pytest.raises(ConfigurationError, match=f"no preset of perturbation for {joints} joints"):
        presets.perturbation(1, joints)


def test_law_for_two_joints_is_that_of_the_design() -> None:
    config = preset_law(ROBOT, POSTURE)
    assert np.array_equal(config.target_posture, POSTURE)
    assert config.target_inertia.tolist() == [0.2, 0.1]
    assert config.target_damping.tolist() == [2.0, 1.0]
    assert config.target_stiffness.tolist() == [10.0, 10.0]
    assert np.array_equal(config.model_inertia, ROBOT)
    assert (config.lock_frequency, config.lock_damping_ratio, config.gamma) == (120.0, 1.0, 100.0)
    reference = preset_law(ROBOT, POSTURE, "tde")
    assert reference.observer is None
    assert reference.model_inertia == pytest.approx(0.6 * ROBOT)
    assert (reference.lock_frequency, reference.gamma) == (100.0, 100.0)


@pytest.mark.parametrize("n", [1, 3, 7])
def test_law_for_other_numbers_of_joints_follows_the_robot(n: int) -> None:
    root = np.random.default_rng(n).normal(size=(n, n))
    robot = root @ root.T + np.eye(n)
    config = preset_law(robot, np.zeros(n))
    assert config.target_inertia == pytest.approx(0.56 * np.diag(robot))
    assert config.target_damping / config.target_inertia == pytest.approx(np.full(n, 10.0))
    assert config.target_stiffness / config.target_inertia == pytest.approx(np.full(n, 100.0))
    assert np.array_equal(config.model_inertia, robot)


@pytest.mark.parametrize("internal_model", ["observer", "tde"])
@pytest.mark.parametrize("joints", range(1, 8))
def test_limits_fit_every_number_of_joints(
    joints: int, internal_model: presets.InternalModel
) -> None:
    config = presets.safety(joints, 9.0, internal_model)
    assert config.rules(np.zeros(joints), 1e-3).shape[1] == joints
    # With raw differences nominal experiments need up to 77 N·m with three joints, 92 with seven.
    chatter = 80.0 if joints <= 3 else 140.0
    assert config.torque_limit == (27.0 if internal_model == "observer" else chatter)
    # Not so wide that they could never matter.
    assert config.rate_limit * 1e-3 < 2.0 * config.torque_limit
