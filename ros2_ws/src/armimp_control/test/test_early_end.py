"""Trials that end before their time, as the estimator says that they are good enough."""

from dataclasses import replace

import numpy as np
import pytest

from armimp_common.status import NOTICE_TICKS, Cause, Phase, StoppingDecision, TrialStatus
from armimp_common.topics import PERIOD_NS
from armimp_control.parameters import ControllerParameters
from armimp_control.perturbation import perturbation
from armimp_control.sequence import SequenceParameters
from armimp_control.trial_sequencer import TrialSequencer

POSTURE = np.radians([62.708, 77.260])
SETTLE, PERTURB, REST = 50, 1000, 60
JUDGED = 300
END = JUDGED + NOTICE_TICKS
PARAMETERS = ControllerParameters.preset(
    joints=("shoulder", "elbow"),
    posture=POSTURE,
    robot_inertia=np.array([[0.354, 0.191], [0.191, 0.180]]),
    arm_inertia=np.array([[0.187, 0.084], [0.079, 0.060]]),
).model_copy(
    update={
        "sequence": SequenceParameters(
            duration=PERTURB / 1000, settle=SETTLE / 1000, rest=REST / 1000
        )
    }
)
ANNOUNCED = StoppingDecision(trial=1, samples=0, enough=False, due=JUDGED, bound=0.02)
ENOUGH = StoppingDecision(trial=1, samples=JUDGED, enough=True, due=None, bound=0.02, largest=0.01)
NOT_YET = replace(ENOUGH, enough=False, due=600, largest=0.03)


class Bench:
    """An experiment at rest in its posture, with what it says."""

    def __init__(self) -> None:
        self.statuses: list[TrialStatus] = []
        self.perturbed: list[bool] = []
        self.torques: list[float] = []
        self.experiment = TrialSequencer(PARAMETERS, self.statuses.append)

    def run(self, ticks: int) -> None:
        for _ in range(ticks):
            stamp_ns = self.experiment.tick * PERIOD_NS
            self.experiment.answer(stamp_ns, tuple(POSTURE), (0.0, 0.0))
            self.torques.append(float(self.experiment.tau_delta[0]))

    def run_into_perturbation(self, ticks: int) -> None:
        self.run(SETTLE + ticks)

    def said(self, phase: Phase, trial: int) -> list[TrialStatus]:
        return [one for one in self.statuses if (one.phase, one.trial) == (phase, trial)]


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_when_a_trial_is_good_enough_expect_its_end_announced_and_kept(bench: Bench) -> None:
    bench.run_into_perturbation(JUDGED + 40)
    bench.experiment.decide(ENOUGH)
    bench.run(PERTURB)

    first, second = bench.said(Phase.PERTURB, 1)
    assert (first.ticks, second.ticks) == (PERTURB, END)
    assert second.tick == SETTLE + JUDGED + 40
    assert first.start_ns == second.start_ns
    (rest,) = bench.said(Phase.REST, 1)
    assert (rest.tick, rest.ticks, rest.valid) == (SETTLE + END, END, True)
    signal = perturbation(
        PARAMETERS.perturbation, joint=0, trial=1, ticks=PERTURB, seed=PARAMETERS.seed
    )
    start = SETTLE
    np.testing.assert_array_equal(bench.torques[start : start + END], signal[:END])
    assert not any(bench.torques[start + END : start + END + REST])


def test_the_next_trial_follows_at_once_and_lasts_as_planned(bench: Bench) -> None:
    bench.run_into_perturbation(JUDGED)
    bench.experiment.decide(ENOUGH)
    bench.run(NOTICE_TICKS + REST + SETTLE + PERTURB + REST + 1)

    first = SETTLE + END + REST
    (settle,), (perturb,) = bench.said(Phase.SETTLE, 2), bench.said(Phase.PERTURB, 2)
    (rest,), (done,) = bench.said(Phase.REST, 2), bench.said(Phase.DONE, 2)
    assert [one.tick for one in (settle, perturb, rest, done)] == [
        first,
        first + SETTLE,
        first + SETTLE + PERTURB,
        first + SETTLE + PERTURB + REST,
    ]
    assert {one.ticks for one in (settle, perturb, rest, done)} == {PERTURB}


def test_a_decision_that_comes_late_leaves_time_to_hear_of_the_end(bench: Bench) -> None:
    bench.run_into_perturbation(END + 100)
    bench.experiment.decide(ENOUGH)
    bench.run(PERTURB)

    ticks = END + 100 + NOTICE_TICKS
    assert bench.said(Phase.PERTURB, 1)[-1].ticks == ticks
    assert bench.said(Phase.REST, 1)[0].tick == SETTLE + ticks


@pytest.mark.parametrize(
    ("ticks", "decision"),
    [
        (JUDGED, replace(ENOUGH, trial=2)),
        (JUDGED - 1, ENOUGH),
        (PERTURB - NOTICE_TICKS, replace(ENOUGH, samples=PERTURB - NOTICE_TICKS)),
        (PERTURB + 10, ENOUGH),
        (-10, replace(ENOUGH, samples=0)),
    ],
    ids=["another trial", "samples that were not there", "at the end", "at rest", "settling"],
)
def test_when_a_decision_does_not_fit_expect_it_ignored(
    bench: Bench, ticks: int, decision: StoppingDecision
) -> None:
    bench.run_into_perturbation(ticks)
    bench.experiment.decide(decision)
    bench.run(PERTURB + REST - ticks)

    assert [one.ticks for one in bench.said(Phase.PERTURB, 1)] == [PERTURB]
    assert bench.said(Phase.REST, 1)[0].ticks == PERTURB


class TestWaiting:
    def test_the_sample_on_which_a_decision_decides_waits_for_it(self, bench: Bench) -> None:
        bench.run_into_perturbation(1)
        bench.experiment.decide(ANNOUNCED)
        for place in range(1, END):
            assert not bench.experiment.awaits_decision, place
            bench.run(1)
        assert bench.experiment.awaits_decision

        bench.experiment.decide(NOT_YET)
        assert not bench.experiment.awaits_decision
        bench.run(600 + NOTICE_TICKS - END)
        assert bench.experiment.awaits_decision
        bench.experiment.decide(replace(NOT_YET, samples=600, due=None))
        bench.run(PERTURB)
        assert not bench.experiment.awaits_decision

    @pytest.mark.parametrize("waiting", [False, True])
    def test_nothing_waits_once_the_experiment_is_over(self, bench: Bench, waiting: bool) -> None:
        bench.run_into_perturbation(1)
        bench.experiment.decide(ANNOUNCED)
        bench.run(END - 1 if waiting else 10)
        bench.experiment.abort(Cause.OTHER, "enough of that")
        bench.run(PERTURB)
        assert not bench.experiment.awaits_decision
