"""Configurations that make no sense are refused in one line with the offending value."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from armimp_common.errors import ConfigurationError
from armimp_sim import presets
from armimp_sim.model.arm import HumanArm
from armimp_sim.model.robot import PlanarChain
from support.plants import study_plant


def _arm(n: int) -> HumanArm:
    return HumanArm(posture=np.zeros(n), inertia=np.eye(n), damping=np.eye(n), stiffness=np.eye(n))


def test_arm_matrices_are_kept_as_given_and_never_made_symmetric() -> None:
    stiffness = np.array([[8.0, 3.0], [-1.0, 7.0]])
    assert np.array_equal(replace(_arm(2), stiffness=stiffness).stiffness, stiffness)


def test_robot_with_a_link_lighter_than_a_point_mass_is_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"link 2 .* at least m·lg² = 0\.0363 .* 0\.03$"):
        replace(presets.robot(2), moments=np.array([0.085, 0.03]))
    # The mass of the first link matters through its moment only, so it may be left out or in.
    heavy = PlanarChain(
        lengths=np.array([0.3]),
        moments=np.array([0.01]),
        masses=np.array([5.0]),
        centres=np.array([0.3]),
    )
    assert heavy.mass_matrix(np.zeros(1)) == pytest.approx(np.array([[0.01]]))


def test_plant_whose_inertia_is_not_positive_definite_is_refused() -> None:
    inertia = np.array([[0.187, 0.9], [0.9, 0.060]])
    arm = replace(presets.human_arm(2), inertia=inertia)
    smallest = np.min(np.linalg.eigvalsh(presets.robot(2).mass_matrix(arm.posture) + inertia))
    with pytest.raises(ConfigurationError, match=f"smallest eigenvalue is {smallest:.3g} kg·m²"):
        replace(study_plant(), arm=arm)
