"""The controller without ROS: phases, perturbation, faults, tare, early ends, samples in pairs."""

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from armimp_common.arrays import FloatArray
from armimp_common.status import NOTICE_TICKS, Phase, StoppingDecision, TrialStatus
from armimp_common.topics import NS_PER_S, PERIOD_NS
from armimp_control.parameters import ControllerParameters
from armimp_control.safety_limiter import SafetyParameters
from armimp_control.sequence import TareParameters
from armimp_control.trial_sequencer import SamplePairs, TrialSequencer, Watchdog
from support.controller import POSTURE, controller_parameters, wobble
from support.streams import changed

SETTLE, PERTURB, REST = 50, 200, 59
TRIAL = SETTLE + PERTURB + REST
START = 7_000_000_000
STILL = (0.0, 0.0)
Reading = Sequence[float] | FloatArray
PARAMETERS = controller_parameters(SETTLE, PERTURB, REST)


class Bench:
    """An experiment that is fed by hand, with a log of its statuses and answers."""

    def __init__(self, parameters: ControllerParameters = PARAMETERS) -> None:
        self.parameters, self.stamp_ns = parameters, START
        self.statuses: list[TrialStatus] = []
        self.commands: list[FloatArray] = []
        self.perturbations: list[FloatArray] = []
        self.experiment = TrialSequencer(parameters, self.statuses.append)

    def answer(self, theta: Reading, tau_h: Reading = STILL) -> None:
        self.experiment.answer(self.stamp_ns, tuple(theta), tuple(tau_h))
        self.commands.append(self.experiment.command.copy())
        self.perturbations.append(self.experiment.tau_delta.copy())
        self.stamp_ns += PERIOD_NS

    def run(self, ticks: int, tau_h: Reading = STILL) -> list[FloatArray]:
        """Feed the posture and a torque on the arm; return the commands."""
        for _ in range(ticks):
            self.answer(POSTURE, tau_h)
        return self.commands[len(self.commands) - ticks :]

    def wobble(self, ticks: int) -> list[tuple[tuple[float, ...], tuple[float, ...]]]:
        """Feed a random movement, and return it."""
        samples = wobble(ticks)
        for theta, tau_h in samples:
            self.answer(theta, tau_h)
        return samples

    def said(self, phase: Phase, trial: int) -> list[TrialStatus]:
        return [one for one in self.statuses if (one.phase, one.trial) == (phase, trial)]

    @property
    def last(self) -> TrialStatus:
        return self.statuses[-1]


def test_phases_are_announced_at_their_first_tick() -> None:
    bench = Bench()

    bench.run(2 * TRIAL + 10)

    assert [(one.phase, one.trial, one.tick) for one in bench.statuses] == [
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
        assert status.joint == status.trial - 1
        assert status.joint_name == ("shoulder", "elbow")[status.joint]
    assert bench.experiment.finished


BEFORE = START + (SETTLE + 9) * PERIOD_NS


@pytest.mark.parametrize(
    ("step", "words"),
    [
        *(
            (ns / NS_PER_S, (f"stamp {BEFORE + ns} ns follows {BEFORE} ns", "must move forward"))
            for ns in (0, -PERIOD_NS, -500 * PERIOD_NS)
        ),
        *(
            (step, (f"stamps jump by {step:+g} s", "the clock of the rig was set"))
            for step in (-20.0, -1.0, 1.0, 3600.0)
        ),
    ],
)
def test_when_stamps_stand_still_or_the_clock_of_the_rig_is_set_expect_an_abort_that_says_so(
    step: float, words: tuple[str, ...]
) -> None:
    bench = Bench()
    bench.wobble(SETTLE + 10)
    bench.stamp_ns += round(step * NS_PER_S) - PERIOD_NS

    bench.answer(POSTURE)

    assert not bench.commands[-1].any()
    assert bench.last.phase is Phase.ABORTED
    assert [one for one in words if one not in bench.last.reason] == []


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
    assert bench.experiment.controller.clipped["torque"] == clipped.sum() > TRIAL
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


# --- Pairing of readings by stamp: none is taken for another, and none waits for ever -----------


@given(st.permutations([(what, stamp) for what in "pt" for stamp in range(4)]))
def test_in_any_order_readings_meet_only_those_of_their_stamp_and_the_latest_always_does(
    order: Sequence[tuple[str, int]],
) -> None:
    pairs = SamplePairs()
    met: list[int] = []
    for what, stamp in order:
        other = pairs.other("pt".index(what), stamp, (float(stamp), 0.0))
        if other is not None:
            assert other == (float(stamp), 0.0)
            met.append(stamp)
    assert len(met) == len(set(met))
    assert max(met) == 3


def test_a_reading_whose_partner_was_lost_is_given_up_with_the_next_pair() -> None:
    pairs = SamplePairs()
    assert pairs.other(0, 1, (1.0,)) is None
    assert pairs.other(1, 2, (2.0,)) is None
    assert pairs.other(0, 4, (4.0,)) is None
    assert pairs.other(0, 3, (3.0,)) is None

    assert pairs.other(1, 3, (0.0,)) == (3.0,)

    assert pairs.other(1, 1, (0.0,)) is None
    assert pairs.other(0, 2, (0.0,)) is None
    assert pairs.other(1, 4, (0.0,)) == (4.0,), "it was not older"


def test_readings_of_one_kind_alone_do_not_pile_up_for_ever() -> None:
    pairs = SamplePairs()
    assert not any(pairs.other(0, stamp, (1.0,)) for stamp in range(20_000))
    assert pairs.other(1, 0, (0.0,)) is None
    assert pairs.other(1, 19_999, (0.0,)) == (1.0,)


# --- Trials that end early, because the estimator says that they are good enough ----------------

PLANNED = 1000
JUDGED = 300
END = JUDGED + NOTICE_TICKS
LONG = controller_parameters(SETTLE, PLANNED, REST)
ENOUGH = StoppingDecision(trial=1, samples=JUDGED, enough=True, due=None, bound=0.02, largest=0.01)


@pytest.fixture
def bench() -> Bench:
    """An experiment at rest in its posture, with its log."""
    return Bench(LONG)


def test_when_a_trial_is_good_enough_expect_its_end_announced_and_kept(
    bench: Bench,
) -> None:
    bench.run(SETTLE + JUDGED + 40)
    bench.experiment.decide(ENOUGH)
    bench.run(PLANNED)

    first, second = bench.said(Phase.PERTURB, 1)
    assert (first.ticks, second.ticks) == (PLANNED, END)
    assert second.tick == SETTLE + JUDGED + 40
    assert first.start_ns == second.start_ns
    (rest,) = bench.said(Phase.REST, 1)
    assert (rest.tick, rest.ticks, rest.valid) == (SETTLE + END, END, True)
    signal = LONG.signal(0, trial=1, ticks=PLANNED)
    start = SETTLE
    torques = [one[0] for one in bench.perturbations]
    np.testing.assert_array_equal(torques[start : start + END], signal[:END])
    assert not any(torques[start + END : start + END + REST])
    # The next trial follows at once, and is to last as planned.
    (settle,) = bench.said(Phase.SETTLE, 2)
    assert (settle.tick, settle.ticks) == (SETTLE + END + REST, PLANNED)


def test_a_decision_that_comes_late_leaves_time_to_hear_of_the_end(bench: Bench) -> None:
    bench.run(SETTLE + END + 100)
    bench.experiment.decide(ENOUGH)
    bench.run(PLANNED)

    ticks = END + 100 + NOTICE_TICKS
    assert bench.said(Phase.PERTURB, 1)[-1].ticks == ticks
    assert bench.said(Phase.REST, 1)[0].tick == SETTLE + ticks


@pytest.mark.parametrize(
    ("ticks", "decision"),
    [
        (JUDGED, changed(ENOUGH, trial=2)),
        (JUDGED - 1, ENOUGH),
        (PLANNED - NOTICE_TICKS, changed(ENOUGH, samples=PLANNED - NOTICE_TICKS)),
        (PLANNED + 10, ENOUGH),
        (-10, changed(ENOUGH, samples=0)),
    ],
    ids=["another trial", "samples that were not there", "at the end", "at rest", "settling"],
)
def test_when_a_decision_does_not_fit_expect_it_ignored(
    bench: Bench, ticks: int, decision: StoppingDecision
) -> None:
    bench.run(SETTLE + ticks)
    bench.experiment.decide(decision)
    bench.run(PLANNED + REST - ticks)

    assert [one.ticks for one in bench.said(Phase.PERTURB, 1)] == [PLANNED]
    assert bench.said(Phase.REST, 1)[0].ticks == PLANNED


# --- The tare of the torque transducers: what it is, when it is taken, which is refused ---------

WAIT, READ = 100, 400
TARED = WAIT + READ + TRIAL


@pytest.mark.parametrize(("ticks", "left"), [(400, 0.02), (1000, 0.002), (1003, 0.002)])
def test_dither_and_mains_hum_do_not_reach_the_tare(ticks: int, left: float) -> None:
    t = 1e-3 * np.arange(ticks)
    hum = sum(np.sin(2.0 * np.pi * f * t + f) for f in (35.0, 54.25, 50.0))
    found = TareParameters(wait=0.0).of(np.array([0.7 + 2.0 * hum, -0.3 - hum]))
    assert found.offset == pytest.approx((0.7, -0.3), abs=left)
    assert max(found.error) < left


def test_the_standard_error_covers_noise_and_shows_unrest() -> None:
    rng = np.random.default_rng(3)
    found = [TareParameters(wait=0.0).of(rng.standard_normal((1, 1000))) for _ in range(400)]
    scatter = np.std([one.offset[0] for one in found])
    assert np.sqrt(np.mean([one.error[0] ** 2 for one in found])) == pytest.approx(scatter, rel=0.1)
    slow = np.sin(2.0 * np.pi * np.arange(1000) * 1e-3)
    assert TareParameters(wait=0.0).of(slow[None]).error[0] > 0.2


def tared(**values: Any) -> Bench:
    # Locked joints of this law ignore the torque on the arm, so commands show what the tare does.
    tare = TareParameters(duration=READ / 1000, wait=WAIT / 1000, **values)
    return Bench(controller_parameters(SETTLE, PERTURB, REST, law="tde", tare=tare))


OFFSET = np.array([0.8, -0.5])


def test_an_offset_that_was_tared_does_not_move_the_joint_and_one_that_was_not_does() -> None:
    for shift, moved in ((0.0, False), (0.3, True)):
        bench = tared()
        held = bench.run(WAIT + READ, OFFSET)
        # In its posture, without any torque to feel, a held joint needs none.
        assert np.max(np.abs(held)) == 0.0
        settling = bench.run(SETTLE, OFFSET + np.array([shift, 0.0]))
        assert (np.max(np.abs(settling)) > 0.1) == moved


def test_the_tare_is_announced_with_the_perturbation_and_taken_anew_before_each_trial() -> None:
    bench = tared()
    bench.run(WAIT + READ, OFFSET)
    assert [(one.phase, one.tare) for one in bench.statuses] == [(Phase.SETTLE, ())]
    bench.run(SETTLE + 1, OFFSET)
    assert [one.phase for one in bench.statuses[1:]] == [Phase.PERTURB]
    assert bench.last.tare == pytest.approx(tuple(OFFSET), abs=1e-12)
    assert bench.last.tare_error == pytest.approx((0.0, 0.0), abs=1e-12)
    bench.run(TARED - WAIT - READ - SETTLE - 1, OFFSET)
    assert [one.phase for one in bench.statuses[2:]] == [Phase.REST]
    bench.run(1, OFFSET)
    assert (bench.last.phase, bench.last.trial, bench.last.tare) == (Phase.SETTLE, 2, ())
    bench.run(WAIT + READ + SETTLE, 2.0 * OFFSET)
    assert [one.phase for one in bench.statuses[4:]] == [Phase.PERTURB]
    assert bench.last.tare == pytest.approx(tuple(2.0 * OFFSET), abs=1e-12)
    assert TrialStatus.from_values(bench.last.to_values()) == bench.last


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (
            {"limit": 0.6},
            r"the torque of shoulder reads 0\.80?1? N·m at rest, tare\.limit is 0\.6 N·m",
        ),
        ({"noise": 1e-6}, r"the torque of shoulder does not rest: .* tare\.noise is 1e-06 N·m"),
    ],
)
def test_a_tare_beyond_its_limits_ends_the_experiment_before_anything_is_perturbed(
    values: dict[str, float], words: str
) -> None:
    bench = tared(**values)
    bench.run(WAIT + READ // 2, OFFSET)
    bench.run(READ // 2, OFFSET + 1e-3)
    bench.run(1, OFFSET)
    assert bench.last.phase is Phase.ABORTED
    assert not bench.last.valid
    assert re.search(words, bench.last.reason)
    assert bench.experiment.finished
    bench.run(SETTLE + 10, OFFSET)
    assert not bench.experiment.tau_delta.any()
    assert bench.experiment.at_rest


def _watchdog(now: float, *, ticks: int = 5, slowest: float = 1e-3) -> Watchdog:
    """A watchdog that was fed now (s)."""
    config = SafetyParameters(watchdog_ticks=ticks, ramp_time=0.05)
    watchdog = Watchdog(config, slowest_tick=slowest)
    watchdog.feed(now)
    return watchdog


def test_after_the_patience_the_ramp_keeps_pace_with_the_clock() -> None:
    watchdog = _watchdog(10.0)
    assert not watchdog.expired(10.0049)
    assert watchdog.expired(10.0051)
    assert [watchdog.ticks_due(now) for now in (10.0051, 10.0052, 10.0071, 10.0301)] == [
        *(1, 0, 2, 23)
    ]
    assert watchdog.ticks_due(1e6) == 24
    assert watchdog.ticks_due(1e6 + 1.0) == 0


def test_a_sample_after_a_silence_starts_the_patience_anew() -> None:
    watchdog = _watchdog(0.0)
    assert watchdog.ticks_due(0.0201) == 16
    watchdog.feed(0.020)
    assert not watchdog.expired(0.0249)
    assert watchdog.ticks_due(0.0261) == 2


@pytest.mark.parametrize("nonsense", [float("nan"), float("inf")])
def test_a_clock_that_is_not_finite_makes_the_whole_ramp_due(nonsense: float) -> None:
    watchdog = _watchdog(0.0)
    assert watchdog.expired(nonsense)
    assert watchdog.ticks_due(nonsense) == 50


def test_longest_allowed_setting_is_over_within_two_hundred_milliseconds() -> None:
    assert _watchdog(0.0, ticks=100).ticks_due(0.2) == 50


def test_by_default_a_rig_in_lockstep_may_be_silent_for_almost_five_seconds() -> None:
    safety = SafetyParameters()
    watchdog = _watchdog(100.0, ticks=safety.watchdog_ticks, slowest=safety.slowest_tick)
    assert not watchdog.expired(104.99)
    assert watchdog.expired(105.0)
