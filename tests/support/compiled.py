"""Compile rig and controller ahead, since processes side by side would each do it."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from armimp_bringup.config import load_config
from armimp_bringup.offline import run_offline
from armimp_bringup.parameters import NodeParameters, node_parameters
from armimp_control.laws.law import compile_law
from armimp_control.safety_limiter import SafetyParameters
from support.laws import torque_only


def brief_rig(
    *,
    joints: int = 2,
    friction: int = 2,
    level: int = 3,
    seed: int = 1,
    arm_sim: Mapping[str, Any] | None = None,
    imbic_controller: Mapping[str, Any] | None = None,
    safety: SafetyParameters | None = None,
) -> NodeParameters:
    """Parameters of an experiment shorter than a second in which every part is active."""
    brief = {"sequence.duration": 0.4, "sequence.settle": 0.05, "sequence.rest": 0.06}
    options = {
        "joints": joints,
        "friction": friction,
        "resolution": level,
        "perturbation": level,
        "seed": seed,
        "arm_sim": {"voluntary.rms": 0.2, **(arm_sim or {})},
        "imbic_controller": {**brief, **(imbic_controller or {})},
    }
    parameters = node_parameters(load_config(None, options), None)
    # In so short a perturbation, scaled to its peak, joints are faster than in a long one.
    limits = {"safety": safety or torque_only(80.0)}
    return replace(parameters, controller=parameters.controller.model_copy(update=limits))


def main() -> None:
    """Compile what most tests need."""
    rig, noisy = brief_rig(), brief_rig(arm_sim={"sensors.torque.noise": 0.01})
    for rigs in ([rig], [rig, rig], [noisy]):
        run_offline(rigs)
    for joints in (1, 3):
        run_offline([brief_rig(joints=joints)])
    controller = brief_rig().controller
    compile_law(controller.control_law(), controller.safety)


if __name__ == "__main__":
    main()
