"""The check of sampled stability, against the loop itself on a rig of pure inertia."""

from collections import deque
from dataclasses import replace

import numpy as np
import pytest

from armimp_common.arrays import FloatArray as Array
from armimp_common.errors import ConfigurationError
from armimp_common.topics import PERIOD
from armimp_control.laws import NO_JOINT, Law
from armimp_control.laws.law import Controller
from armimp_control.rig import RigDynamics
from armimp_control.stability import check_stability, spectral_radius
from support.laws import ARM, POSTURE, ROBOT, knowing, preset_law, torque_only, with_law

TDE = preset_law(ROBOT, POSTURE, "tde")
STEPS = 20


def _late(law: Law, perturbed: int, dynamics: RigDynamics, *, ticks: int) -> Array:
    """Largest acceleration (ticks,) after a push, of a rig of inertia alone, in small steps."""
    controller = Controller(law, safety=torque_only(1e300))
    controller.perturb_joint(perturbed)
    inverse, h = np.linalg.inv(ROBOT + ARM), PERIOD / STEPS
    lag = np.exp(-h / dynamics.actuator_lag) if dynamics.actuator_lag else 0.0
    low = np.exp(-2.0 * np.pi * dynamics.torque_cutoff * h) if dynamics.torque_cutoff else 0.0
    theta, velocity = POSTURE.copy(), np.zeros(2)
    drive, passed = np.zeros(2), np.zeros(2)
    readings = [np.zeros(2)] * (1 + round(dynamics.torque_delay / h))
    push, sizes = np.array([1.0, 1.0]), np.zeros(ticks)
    under_way = deque([np.zeros(2)] * dynamics.command_delay)
    for tick in range(ticks):
        controller.sample[:2] = theta, readings[-1 - round(dynamics.torque_delay / h)]
        controller.compute()
        under_way.append(controller.command.copy())
        command = under_way.popleft() + push
        push = np.zeros(2)
        for _ in range(STEPS):
            before, drive = drive, command + (drive - command) * lag
            acceleration = inverse @ (0.5 * (before + drive) if lag else command)
            theta = theta + h * velocity + 0.5 * h**2 * acceleration
            velocity = velocity + h * acceleration
            load = ARM @ inverse @ drive
            passed = load + (passed - load) * low
            readings.append(passed)
        sizes[tick] = np.max(np.abs(acceleration))
    return sizes


DEFAULT = preset_law(ROBOT, POSTURE)
STIFF = DEFAULT.target.model_copy(update={"lock_frequency": 200.0})
WITH_OBSERVER = replace(with_law(DEFAULT, gamma=200.0), target=STIFF)


@pytest.mark.parametrize(
    ("law", "dynamics"),
    [
        (TDE, RigDynamics(torque_delay=0.02)),
        (TDE, RigDynamics(torque_delay=0.0175, torque_cutoff=300.0)),
        (TDE, RigDynamics(actuator_lag=0.002)),
        (TDE, RigDynamics(actuator_lag=0.003, torque_delay=0.0015)),
        (TDE, RigDynamics(command_delay=2)),
        (TDE, RigDynamics(command_delay=1, actuator_lag=0.001, torque_delay=0.0005)),
        (with_law(TDE, model_inertia=[4.0 * one for one in TDE.law.model_inertia]), RigDynamics()),
        (WITH_OBSERVER, RigDynamics(command_delay=2)),
    ],
)
@pytest.mark.parametrize("perturbed", [0, NO_JOINT])
def test_a_loop_grows_or_comes_to_rest_as_the_check_says(
    law: Law, dynamics: RigDynamics, perturbed: int
) -> None:
    radius = spectral_radius(law, dynamics, perturbed=perturbed)
    if perturbed == NO_JOINT and radius < 0.99:
        # Joints that are held do not feel torques, however late: it comes to rest.
        sizes = _late(law, perturbed, dynamics, ticks=2000)
        assert np.max(sizes[-100:]) < 1e-6 * np.max(sizes)
        return
    assert radius > 1.002
    # By a factor of some hundred altogether; oscillating modes make single peaks erratic.
    third = int(2.0 / np.log(radius)) + 50
    sizes = _late(law, perturbed, dynamics, ticks=3 * third)
    grown = np.max(sizes[2 * third :]) / np.max(sizes[third : 2 * third])
    assert np.log(grown) / third == pytest.approx(np.log(radius), rel=0.15)


@pytest.mark.parametrize(
    ("borne", "refused"),
    [
        ({"torque_delay": 0.0015}, {"torque_delay": 0.002}),
        ({"actuator_lag": 0.001}, {"actuator_lag": 0.0015}),
        ({"command_delay": 0}, {"command_delay": 1}),
        (
            {"actuator_lag": 0.0005, "torque_delay": 0.001},
            {"actuator_lag": 0.0005, "torque_delay": 0.0015},
        ),
    ],
)
def test_the_law_of_the_study_bears_the_delays_that_the_documents_say(
    borne: dict[str, float], refused: dict[str, float]
) -> None:
    check_stability(knowing(TDE, **borne))
    with pytest.raises(ConfigurationError, match="unstable when sampled"):
        check_stability(knowing(TDE, **refused))


def test_the_default_is_accepted_without_a_warning_and_tde_with_one_of_late_commands() -> None:
    assert check_stability(DEFAULT) == ()
    (warning,) = check_stability(TDE)
    assert "commands that act 1 ms later" in warning
    assert warning.endswith("while all joints are locked")
