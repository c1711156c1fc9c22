"""The controller without ROS: phases, perturbation, faults, the account of the samples."""

import numpy as np
import pytest

from armimp_common.status import Phase
from armimp_common.topics import NS_PER_S, PERIOD_NS
from armimp_control.laws.law import Controller
from armimp_control.parameters import ControllerParameters
from armimp_control.perturbation import perturbation
from armimp_control.safety_limiter import Limit, SafetyParameters
from support.controller import POSTURE, SequencerBench, controller_parameters

SETTLE, PERTURB, REST = 50, 200, 60
TRIAL = SETTLE + PERTURB + REST
START = 7_000_000_000


PARAMETERS = controller_parameters(SETTLE, PERTURB, REST)


class Bench(SequencerBench):
    """An experiment that is fed, with a diary of what it says and answers."""

    def __init__(self, parameters: ControllerParameters = PARAMETERS) -> None:
        super().__init__(parameters, START)

    @property
    def phases(self) -> list[tuple[Phase, int, int]]:
        return [(status.phase, status.trial, status.tick) for status in self.statuses]


def test_phases_are_announced_at_their_first_tick() -> None:
    bench = Bench()

    bench.run(2 * TRIAL + 10)

    assert bench.phases == [
        (Phase.SETTLE, 1, 0),
        (Phase.PERTURB, 1, SETTLE),
        (Phase.REST, 1, SETTLE + PERTURB),
        (Phase.SETTLE, 2, TRIAL),
        (Phase.PERTURB, 2, TRIAL + SETTLE),
        (Phase.REST, 2, TRIAL + SETTLE + PERTURB),
        (Phase.DONE, 2, 2 * TRIAL),
    ]
    first, second = (START + tick * PERIOD_NS for tick in (SETTLE, TRIAL + SETTLE))
    assert [status.start_ns for status in bench.statuses] == [None, *[first] * 2, None] + (
        [second] * 3
    )
    for status in bench.statuses:
        assert status.valid
        assert (status.trials, status.ticks, status.seed) == (2, PERTURB, 1)
        assert (status.joint, status.joint_name) == (
            status.trial - 1,
            ("shoulder", "elbow")[status.trial - 1],
        )
    assert bench.experiment.finished


def test_perturbation_is_that_of_the_seed_on_one_joint_and_only_while_perturbing() -> None:
    bench = Bench()

    bench.run(2 * TRIAL + 10)

    expected = np.zeros((2 * TRIAL + 10, 2))
    for joint in (0, 1):
        first = joint * TRIAL + SETTLE
        expected[first : first + PERTURB, joint] = perturbation(
            bench.parameters.perturbation,
            joint=joint,
            trial=joint + 1,
            ticks=PERTURB,
            seed=1,
        )
    np.testing.assert_array_equal(bench.perturbations, expected)


def test_commands_are_those_of_the_law_with_the_role_of_each_trial() -> None:
    bench = Bench()

    samples = bench.wobble(TRIAL + 40)

    law = Controller(bench.parameters.imbic_config(), safety=bench.parameters.safety)
    expected = []
    for tick, (theta, tau_h) in enumerate(samples):
        law.perturb_joint(tick // TRIAL)
        law.tick(np.array(theta), np.array(tau_h), bench.perturbations[tick])
        expected.append(law.command.copy())
    np.testing.assert_array_equal(bench.commands, expected)
    assert np.abs(expected).max() > 0.1


@pytest.mark.parametrize("step", [0, -PERIOD_NS, -500 * PERIOD_NS])
def test_when_stamps_do_not_move_forward_expect_an_abort(step: int) -> None:
    bench = Bench()
    bench.wobble(10)
    bench.stamp_ns += step - PERIOD_NS

    bench.answer(POSTURE)

    assert not bench.commands[-1].any()
    status = bench.statuses[-1]
    assert status.phase is Phase.ABORTED
    assert status.reason == (
        f"stamp {START + 9 * PERIOD_NS + step} ns follows {START + 9 * PERIOD_NS} ns: "
        "samples must move forward"
    )


@pytest.mark.parametrize("step", [-20.0, -1.0, 1.0, 3600.0])
def test_when_the_clock_of_the_rig_is_set_expect_an_abort_that_names_it(step: float) -> None:
    bench = Bench()
    bench.wobble(SETTLE + 10)
    bench.stamp_ns += round(step * NS_PER_S) - PERIOD_NS

    bench.answer(POSTURE)

    assert not bench.commands[-1].any()
    status = bench.statuses[-1]
    assert status.phase is Phase.ABORTED
    assert f"stamps jump by {step:+g} s" in status.reason
    assert "the clock of the rig was set" in status.reason


@pytest.mark.parametrize("gap_at", [SETTLE, SETTLE + 1, SETTLE + PERTURB - 1])
def test_when_samples_are_missing_expect_them_counted_and_only_that_trial_invalid(
    gap_at: int,
) -> None:
    bench = Bench()
    bench.run(gap_at)
    bench.stamp_ns += 3 * PERIOD_NS
    bench.run(1)
    bench.stamp_ns += 2 * PERIOD_NS
    bench.run(TRIAL - gap_at - 1)

    assert bench.experiment.lost == 5
    rest = bench.statuses[-1]
    assert (rest.phase, rest.valid) == (Phase.REST, False)
    assert rest.reason == "5 samples did not arrive"

    bench.run(TRIAL + 1)
    assert [status.valid for status in bench.statuses[-4:]] == [True] * 4
    assert bench.statuses[-1].phase is Phase.DONE


def test_clipped_commands_are_counted_where_the_arm_is_perturbed() -> None:
    bench = Bench(PARAMETERS.model_copy(update={"safety": SafetyParameters(torque_limit=1e-3)}))

    bench.wobble(TRIAL + SETTLE + 20)

    # All joints get less if one does.
    commands = np.array(bench.commands)
    clipped = np.any(np.abs(commands) == 1e-3, axis=1, keepdims=True) & (commands != 0.0)
    trial = clipped[SETTLE : SETTLE + PERTURB]
    assert np.abs(bench.commands).max() <= 1e-3
    assert bench.experiment.clipped[Limit.TORQUE] == clipped.sum() > TRIAL
    settle, perturb, rest, *_ = bench.statuses
    assert (settle.clipped, perturb.clipped, rest.clipped) == (0, 0, trial.sum())
    ticks = np.concatenate(
        [
            np.arange(int(first), int(last) + 1)
            for first, last in (text.split("-") for text in rest.clipped_intervals.split())
        ]
    )
    assert np.array_equal(ticks, np.flatnonzero(trial.any(axis=1)))
    assert [status.clipped for status in bench.statuses[3:]] == [0, 0]
    assert rest.valid
