"""A joint that voluntary torque has moved far from its posture by the time it gets locked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.offline import run_offline
from armimp_bringup.parameters import NodeParameters, node_parameters

pytestmark = pytest.mark.slow


@dataclass(frozen=True, kw_only=True)
class Person:
    """A run in which the first joint is far from its posture when the second trial locks it."""

    seed: int
    duration: float
    voluntary: float

    def rig(self, approach: float, internal_model: str = "observer") -> NodeParameters:
        config = ExperimentConfig(
            friction=3,
            resolution=3,
            perturbation=3,
            seed=self.seed,
            duration=self.duration,
            arm_sim={"voluntary.rms": self.voluntary, "substeps": 20},
            imbic_controller={
                "target.lock_approach": approach,
                "law.internal_model": internal_model,
            },
        )
        return node_parameters(config, None)


# At 0.037 rad, for which a target that jumps asks for about the torque limit: M̄ ω² times that.
AT_THE_LIMIT = Person(seed=119, duration=50.0, voluntary=0.3)
# At −0.069 rad.
BEYOND_IT = Person(seed=0, duration=20.0, voluntary=1.0)


@pytest.mark.parametrize("person", [AT_THE_LIMIT, BEYOND_IT])
def test_joint_is_locked_from_afar_without_a_clip_and_held_in_its_posture(person: Person) -> None:
    default = node_parameters(ExperimentConfig(), None).controller.target.lock_approach
    rig = person.rig(default)
    first, second = run_offline([rig])[0]
    for trial in (first, second):
        assert trial.command is not None
        assert np.max(np.abs(trial.command)) < rig.controller.safety.torque_limit
        assert np.max(np.abs(np.diff(trial.command))) < rig.controller.safety.rate_limit * 1e-3
    target = rig.controller.target.posture
    # Here at the end of the first trial already, a rest before it gets locked.
    assert abs(first.position[0, -1] - target[0]) > 0.01
    assert np.max(np.abs(second.position[0] - target[0])) < 1e-3
