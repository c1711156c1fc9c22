"""A result that says valid is right: recordings of a rig that isn't the project's.

A small part of ``research/truth.py``, with fixed seeds.
"""

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from armimp_bringup.offline_estimate import estimate_bags
from research.independent_rig import Mismatch, arm_of, changed, simulate, write_bag
from research.truth import NOISE, cases, outcome

CASES = cases()
QUICK = (
    "ideal",
    "after",
    "command late 0.5 ms",
    "torque sign",
    "torque gain of joint 2 0.9",
    "torque larger in one direction 0.1",
    "torque compressed 0.03",
    "gain that grows 0.02",
    "short-range stiffness 1",
    "amplitude-dependent 0.1",
    "friction 2 N·m",
    "reflex 0.3, 40 ms",
    "voluntary 0.3 N·m",
    "sticking, voluntary 0.7 N·m",
)


def judge(name: str, seed: int) -> None:
    kind, mismatch = CASES[name]
    valid, worst, _, problems = outcome(mismatch, seed)
    assert not valid or worst <= 3.5, (worst, problems)
    if kind == NOISE:
        assert valid, problems
    assert valid or problems


@pytest.mark.parametrize("name", QUICK)
def test_what_is_valid_is_right_and_noise_is_valid(name: str) -> None:
    judge(name, seed=11)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(set(CASES) - set(QUICK)))
def test_what_is_valid_is_right_in_each_class(name: str) -> None:
    judge(name, seed=0)


@pytest.mark.parametrize("name", ["torque gain of joint 2 0.95", "cross-talk 2 %"])
def test_what_the_balance_leaves_of_a_gain_is_in_the_intervals(name: str) -> None:
    valid, worst, percent, _ = outcome(CASES[name][1], seed=0)
    assert valid
    assert worst <= 3.5
    assert percent > 3.5, "one per cent, as assumed of any transducer, would not hold it"


def test_a_soft_cuff_that_noise_hides_in_some_elements_is_in_the_intervals_of_all() -> None:
    judge("cuff, voluntary 0.3 N·m 100 kN·m/rad", seed=5)


@pytest.mark.parametrize("seed", [0, 3])
def test_stiffness_that_falls_while_a_person_pushes_is_in_the_intervals_or_refused(
    seed: int,
) -> None:
    judge("amplitude-dependent, voluntary 0.3 N·m 0.1", seed)


@pytest.mark.parametrize("name", ["multisine", "torque compressed, multisine 0.03"])
def test_all_lines_of_a_multisine_neither_make_an_arm_look_bent_nor_a_transducer_linear(
    name: str,
) -> None:
    judge(name, seed=0)


def test_what_coarse_encoders_miss_of_a_joint_that_friction_holds_is_in_the_intervals() -> None:
    judge("sticking 1 N·m, 0.0005 rad", seed=25)


@pytest.mark.parametrize(
    "name", ["torque larger in one direction, voluntary 0.3 N·m", "voluntary and tremor 1 N·m"]
)
def test_what_a_person_does_neither_hides_a_bent_transducer_nor_looks_like_friction(
    name: str,
) -> None:
    judge(name, seed=1)


@pytest.mark.parametrize("level", [0.5, 1.0])
def test_one_torque_that_is_read_for_both_joints_is_refused(level: float) -> None:
    twice = changed(torque=lambda torque: np.repeat(torque[:1], 2, axis=0))
    valid, _, _, problems = outcome(Mismatch(duration=10.0, level=level, readings=twice), seed=0)
    assert not valid
    assert any("passive" in one for one in problems), problems


READINGS: dict[str, dict[str, bool]] = {
    "before": {},
    "after": {"after": True},
    "mean": {"mean": True},
}
QUICK_BAGS = {(800.0, "mean", False), (500.0, "before", True)}


@pytest.mark.parametrize(
    ("rate", "reading", "commands"),
    [
        pytest.param(*one, marks=() if one in QUICK_BAGS else pytest.mark.slow)
        for one in itertools.product((500.0, 800.0, 1000.0, 2000.0), READINGS, (True, False))
    ],
)
def test_bags_of_another_rig_at_other_rates_are_right_with_joints_in_any_order(
    tmp_path: Path, rate: float, reading: str, commands: bool
) -> None:
    mismatch = replace(Mismatch(rate=rate, duration=10.0), **READINGS[reading])  # type: ignore[arg-type]
    path = tmp_path / "bag"
    write_bag(path, simulate(mismatch, 3), orders=((1, 0), (0, 1), (0, 1)), commands=commands)
    result = estimate_bags([path], ("lpm_full",))
    summary = result.summary
    assert summary.valid, summary.problems
    assert summary.verdict.impedance
    found = summary.estimators["lpm_full"]
    for letter, truth in zip("MBK", arm_of(mismatch), strict=True):
        error = np.abs(np.array(getattr(found, letter)) - truth)
        assert (error <= 3.5 * np.array(getattr(found, f"{letter}_se"))).all(), letter
    assert summary.joints == 2
