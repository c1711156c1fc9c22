"""Plain PD locking, the negative control: its equations, edges, stability, and choice."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from armimp_common.schema import build, flatten
from armimp_control.laws import TargetParameters
from armimp_control.laws.imbic import ImbicConfig
from armimp_control.laws.law import Controller
from armimp_control.laws.pd import PdConfig
from armimp_control.parameters import ControllerParameters
from support.controller import controller_parameters
from support.laws import torque_only, within_torque

PERIOD = 1e-3


def _config(n: int) -> PdConfig:
    random = np.random.default_rng(n)
    target = TargetParameters(
        posture=tuple(random.uniform(-1.0, 1.0, n)),
        inertia=(1.0,) * n,
        damping=tuple(random.uniform(1.0, 3.0, n)),
        stiffness=tuple(random.uniform(5.0, 15.0, n)),
    )
    inertia = random.uniform(0.1, 0.4, n)
    return PdConfig(target=target, inertia=inertia, frequency=25.0, damping_ratio=0.8)


def _parameters(**changes: Any) -> ControllerParameters:
    return build(ControllerParameters, {**flatten(controller_parameters()), **changes})


# --- the law ---------------------------------------------------------------------------------


@pytest.mark.parametrize("limit", [1e9, 4.0])
@pytest.mark.parametrize("n", [1, 2, 3, 7])
def test_locked_joints_are_held_by_stiffness_and_damping_and_the_perturbed_one_by_its_target(
    n: int, limit: float
) -> None:
    config = _config(n)
    controller = Controller(config, safety=torque_only(limit))
    random = np.random.default_rng(10 + n)
    last = theta = config.target_posture + 0.01
    saturated = 0
    for tick in range(200):
        perturbed = (tick // 20) % n
        controller.perturb_joint(perturbed)
        tau_delta = np.where(np.arange(n) == perturbed, random.uniform(-9.0, 9.0), 0.0)
        clipped = controller.tick(theta, random.normal(size=n), tau_delta)
        expected = np.zeros(n)
        for i in range(n):
            stiffness = 25.0**2 * config.inertia[i]
            damping = 2.0 * 0.8 * 25.0 * config.inertia[i]
            if i == perturbed:
                stiffness, damping = config.target.stiffness[i], config.target.damping[i]
            velocity = (theta[i] - last[i]) / PERIOD
            expected[i] = stiffness * (config.target.posture[i] - theta[i]) - damping * velocity
        expected = within_torque(expected + tau_delta, limit)
        assert controller.command == pytest.approx(expected, rel=1e-9, abs=1e-9)
        assert clipped == (n if np.max(np.abs(expected)) == limit else 0)
        saturated += clipped
        last, theta = theta, theta + 1e-4 * random.normal(size=n)
    assert (saturated == 0) if limit > 100.0 else (saturated > 0)


# --- the configuration -----------------------------------------------------------------------


def test_law_of_the_study_is_the_default_and_one_parameter_chooses_the_other() -> None:
    assert isinstance(_parameters().law_config(), ImbicConfig)
    chosen = _parameters(**{"law.kind": "pd"})
    law = chosen.law_config()
    assert isinstance(law, PdConfig)
    assert law.inertia == pytest.approx([0.354, 0.180])
    assert (law.frequency, law.damping_ratio, law.period) == (25.0, 1.0, 1e-3)
    assert law.target == _parameters().imbic_config().target
    tuned = _parameters(**{"law.pd_frequency": 40.0, "law.pd_damping_ratio": 0.7}).pd_config()
    assert (tuned.frequency, tuned.damping_ratio) == (40.0, 0.7)
