"""The plant: its integration, equations of motion, friction, lanes, and what is refused."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from armimp_common.arrays import FloatArray as Array
from armimp_common.errors import ArmimpError, ConfigurationError
from armimp_common.topics import PERIOD
from armimp_sim import dynamics, presets
from armimp_sim.model.friction import LuGre
from armimp_sim.model.robot import PlanarChain
from armimp_sim.model.sensors import Sampling
from armimp_sim.parameters import RK4_RADIUS, SimulatorParameters
from armimp_sim.plant import IntegrationError, Plant
from support.plants import changed, load, random_plant, run, set_state, slopes, study_plant

START = np.array([[1.3, 0.9], [4.0, -7.0], [0.0, 0.0]])
TORQUE = np.array([1.5, -2.0])


def _exact(config: SimulatorParameters, start: Array, torque: Array, duration: float) -> Array:
    solution = solve_ivp(
        lambda _, state: slopes(config, state.reshape(3, -1), torque).ravel(),
        (0.0, duration),
        start.ravel(),
        method="DOP853",
        rtol=1e-12,
        atol=1e-14,
    )
    assert solution.success
    final: Array = solution.y[:, -1].reshape(3, -1)
    return final


@pytest.mark.parametrize("friction", [0, 3])
def test_trajectory_agrees_with_scipy(friction: int) -> None:
    config = study_plant(friction)
    plant = Plant([config])
    set_state(plant, START)
    expected = START
    # Sliding, stopping and turning back: the bristles bend both ways.
    for torque, ticks in ((TORQUE, 60), (np.array([-25.0, 15.0]), 80), (np.zeros(2), 60)):
        state = run(plant, np.tile(torque, (ticks, 1)))[0][-1]
        expected = _exact(config, expected, torque, ticks * PERIOD)
        assert state[0] == pytest.approx(expected[0], abs=1e-8)
        assert state[1] == pytest.approx(expected[1], abs=1e-6)
        if friction:
            assert state[2] == pytest.approx(expected[2], abs=1e-9)
            assert np.max(np.abs(state[2])) > 1e-4


def test_coarsest_accepted_step_is_stable_and_no_step_beyond_the_limit_is_accepted() -> None:
    law = LuGre(coulomb=(2.0,), static=(2.5,), sigma_0=(2000.0,), sigma_1=(1000.0,))
    config = changed(study_plant(), friction=law)
    fastest = 1000.0 / np.min(np.linalg.eigvals(config.mass_matrix()).real)  # σ1 over inertia
    accepted = []
    for substeps in range(4, 40):
        coarser = changed(config, substeps=substeps)
        try:
            coarser.check()
            accepted.append(coarser)
        except ConfigurationError:
            assert fastest * PERIOD / substeps > 0.98 * RK4_RADIUS
    coarsest = accepted[0]
    assert 4 < coarsest.substeps < 39
    assert fastest * PERIOD / coarsest.substeps < RK4_RADIUS
    states, _ = run(coarsest, np.full((100, 2), 0.1))
    assert np.max(np.abs(states[-1, 1])) < 1e-3


def test_speed_beyond_the_stability_of_the_bristles_is_reported_instead_of_blowing_up() -> None:
    config = study_plant(3)
    plant = Plant([changed(config, substeps=10)])
    set_state(plant, np.array([config.arm.theta_0, [0.0, 30.0], [0.0, 0.0]]))
    with pytest.raises(IntegrationError, match=r"h·σ0\|v\|/g\(v\) = \d+.* below 2\.7") as caught:
        plant.tick(np.zeros((1, 2)), np.zeros((1, 2)))
    assert "\n" not in str(caught.value)
    assert isinstance(caught.value, ArmimpError)


@pytest.mark.parametrize("shape", [(2,), (1, 3), (1, 1), (2, 2)])
def test_inputs_of_another_shape_are_refused(shape: tuple[int, ...]) -> None:
    plant, good = Plant([study_plant()]), np.zeros((1, 2))
    with pytest.raises(ValueError, match="must both be"):
        plant.tick(np.zeros(shape), good)
    with pytest.raises(ValueError, match="must both be"):
        plant.tick(good, np.zeros(shape))


JOINTS = range(1, 8)
"""A plant of each size is compiled for itself."""


@pytest.mark.parametrize(
    "n", [2, *(pytest.param(n, marks=pytest.mark.slow) for n in JOINTS if n != 2)]
)
def test_torque_on_the_arm_is_that_of_the_equations_of_motion(n: int) -> None:
    config = random_plant(n)
    plant = Plant([config])
    rows = plant.batch.w.reshape(-1, n)
    random = np.random.default_rng(n)
    for _ in range(20):
        # Slow and fast, stuck and sliding.
        velocity = random.normal(size=n) * 10.0 ** random.uniform(-3.0, 1.0, n)
        state = np.stack(
            [random.uniform(-np.pi, np.pi, n), velocity, random.uniform(-2e-3, 2e-3, n)]
        )
        command, voluntary = random.uniform(-20.0, 20.0, (2, n))
        rows[dynamics.COMMAND], rows[dynamics.VOLUNTARY] = command, voluntary
        set_state(plant, state)
        expected = load(config, state, command, voluntary)
        scale = float(np.max(np.abs(expected)))
        assert plant.torque[0] == pytest.approx(expected, abs=1e-11 * scale)


def test_lanes_that_disagree_in_time_or_shape_are_refused() -> None:
    one = random_plant(2)
    for other in (
        random_plant(3),
        changed(one, substeps=one.substeps + 1),
        changed(one, sensors=one.sensors.model_copy(update={"sampling": Sampling.INTERVAL_MEAN})),
    ):
        with pytest.raises(ConfigurationError, match="lanes must agree"):
            Plant([one, other])


def test_robot_with_a_link_lighter_than_a_point_mass_is_refused() -> None:
    light = {**dict(presets.robot(2)), "moments": (0.085, 0.03)}
    with pytest.raises(ValueError, match=r"link 2 .* at least m·lg² = 0\.0363 .* 0\.03 "):
        PlanarChain(**light)
    # The mass of the first link matters through its moment only, so it may be left out or in.
    heavy = PlanarChain(lengths=(0.3,), moments=(0.01,), masses=(5.0,), centres=(0.3,))
    assert heavy.mass_matrix(np.zeros(1)) == pytest.approx(np.array([[0.01]]))


def test_plant_whose_inertia_is_not_positive_definite_is_refused() -> None:
    arm = presets.human_arm(2).model_copy(update={"inertia": (0.187, 0.9, 0.9, 0.060)})
    smallest = np.min(np.linalg.eigvalsh(presets.robot(2).mass_matrix(arm.theta_0) + arm.M))
    with pytest.raises(ConfigurationError, match=f"smallest eigenvalue is {smallest:.3g} kg·m²"):
        changed(study_plant(), arm=arm).check()
