"""The tare of the torque transducers: what it is, when it is taken, which is refused."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from armimp_common.status import Phase, TrialStatus
from armimp_control.sequence import TareParameters
from support.controller import SequencerBench, controller_parameters

WAIT, READ, SETTLE, PERTURB, REST = 100, 400, 50, 200, 60
TRIAL = WAIT + READ + SETTLE + PERTURB + REST


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


def tared(**values: Any) -> SequencerBench:
    # Locked joints of this law do not listen to the arm, so that commands tell what the tare does.
    tare = TareParameters(duration=READ / 1000, wait=WAIT / 1000, **values)
    return SequencerBench(controller_parameters(SETTLE, PERTURB, REST, law="tde", tare=tare))


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
    bench.run(TRIAL - WAIT - READ - SETTLE - 1, OFFSET)
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
