"""A result that says valid is right: recordings of a rig that isn't the project's.

A small part of ``research/truth.py``, with fixed seeds.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from armimp_bringup.offline_estimate import estimate_bags
from research.independent_rig import Mismatch, arm_of, simulate, write_bag
from research.truth import NOISE, cases, outcome

CASES = cases()
QUICK = (
    "ideal",
    "after",
    "command late 0.5 ms",
    "torque sign",
    "torque gain of joint 2 0.9",
    "short-range stiffness 1",
    "reflex 0.3, 40 ms",
    "voluntary 0.3 N·m",
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


@pytest.mark.parametrize(
    ("rate", "options", "commands"),
    [
        pytest.param(500.0, {"after": True}, True, marks=pytest.mark.slow),
        (800.0, {"mean": True}, False),
        pytest.param(2000.0, {}, True, marks=pytest.mark.slow),
    ],
)
def test_bags_of_another_rig_at_other_rates_are_right_with_joints_in_any_order(
    tmp_path: Path, rate: float, options: dict[str, bool], commands: bool
) -> None:
    mismatch = replace(Mismatch(rate=rate, duration=10.0), **options)  # type: ignore[arg-type]
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
