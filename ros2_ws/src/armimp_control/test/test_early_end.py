"""Trials that end before their time, as the estimator says that they are good enough."""

from dataclasses import replace

import numpy as np
import pytest

from armimp_common.status import NOTICE_TICKS, Phase, StoppingDecision
from armimp_control.perturbation import perturbation
from support.controller import SequencerBench, controller_parameters

SETTLE, PERTURB, REST = 50, 1000, 60
JUDGED = 300
END = JUDGED + NOTICE_TICKS
PARAMETERS = controller_parameters(SETTLE, PERTURB, REST)
ENOUGH = StoppingDecision(trial=1, samples=JUDGED, enough=True, due=None, bound=0.02, largest=0.01)


@pytest.fixture
def bench() -> SequencerBench:
    """An experiment at rest in its posture, with what it says."""
    return SequencerBench(PARAMETERS)


def test_when_a_trial_is_good_enough_expect_its_end_announced_and_kept(
    bench: SequencerBench,
) -> None:
    bench.run(SETTLE + JUDGED + 40)
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
    torques = [one[0] for one in bench.perturbations]
    np.testing.assert_array_equal(torques[start : start + END], signal[:END])
    assert not any(torques[start + END : start + END + REST])


def test_the_next_trial_follows_at_once_and_lasts_as_planned(bench: SequencerBench) -> None:
    bench.run(SETTLE + JUDGED)
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


def test_a_decision_that_comes_late_leaves_time_to_hear_of_the_end(bench: SequencerBench) -> None:
    bench.run(SETTLE + END + 100)
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
    bench: SequencerBench, ticks: int, decision: StoppingDecision
) -> None:
    bench.run(SETTLE + ticks)
    bench.experiment.decide(decision)
    bench.run(PERTURB + REST - ticks)

    assert [one.ticks for one in bench.said(Phase.PERTURB, 1)] == [PERTURB]
    assert bench.said(Phase.REST, 1)[0].ticks == PERTURB
