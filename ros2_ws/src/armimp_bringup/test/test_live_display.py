"""The live display: what is measured so far, with its uncertainty, and how far the trial is."""

import io
from dataclasses import replace

import pytest
from rich.console import Console
from rich.text import Text

from armimp_bringup.terminal import Display, describe_column, describe_trial
from armimp_common.status import Phase, Progress

SNAPSHOT = Progress(
    trial=1,
    trials=2,
    joint=2,
    phase=Phase.PERTURB,
    samples=10_000,
    planned=50_000,
    rate=5000.0,
    coherence_motion=0.9876,
    coherence_torque=0.99,
    M=(0.0837, 0.0598),
    M_se=(0.00021, 0.0001),
    B=(0.2358, 0.4051),
    B_se=(0.0017, 0.012),
    K=(3.1082, 6.8538),
    K_se=(0.033, 1.5),
    largest_error=0.0107,
)


def test_column_is_told_with_two_digits_of_each_standard_error() -> None:
    assert describe_column(SNAPSHOT) == [
        "M12 0.08370 ± 0.00021   M22 0.05980 ± 0.00010 kg·m²",
        "B12 0.2358 ± 0.0017   B22 0.405 ± 0.012 N·m·s/rad",
        "K12 3.108 ± 0.033   K22 6.9 ± 1.5 N·m/rad",
        "standard errors up to 1.1 %",
    ]


def test_without_the_columns_of_other_joints_no_standard_error_is_stated() -> None:
    lines = describe_column(replace(SNAPSHOT, preliminary=True))
    assert lines == [
        "M12 0.0837   M22 0.0598 kg·m²",
        "B12 0.236   B22 0.41 N·m·s/rad",
        "K12 3.11   K22 7 N·m/rad",
        "preliminary; random errors up to 1.1 %",
    ]


def test_first_line_has_place_speed_and_time_left() -> None:
    assert describe_trial(SNAPSHOT) == "10.0/50.0 s  5.0x  18 s left"


@pytest.mark.parametrize("joints", [2, 7])
def test_80_columns_hold_bar_joint_and_time_left(joints: int) -> None:
    output = io.StringIO()
    with Display(Console(file=output, force_terminal=True, width=80, height=24)) as display:
        late = replace(SNAPSHOT, samples=9_000_000, planned=9_000_000, rate=99.0, trials=joints)
        display.show(replace(late, trial=joints - 1, joint=joints))
        display.phase("drawing")
    (line,) = {
        one.strip() for one in Text.from_ansi(output.getvalue()).plain.splitlines() if "left" in one
    }
    assert line.startswith(f"trial {joints - 1}/{joints}  joint {joints}")
    assert "━" * 16 in line
    assert line.endswith("left")
    assert "…" not in line


def test_a_terminal_shows_coherence_and_column_and_follows_an_earlier_end() -> None:
    output = io.StringIO()
    console = Console(file=output, force_terminal=True, width=120, height=20)
    with Display(console) as display:
        display.show(SNAPSHOT)
        display.phase("")
        display.show(replace(SNAPSHOT, samples=20_000, planned=20_000))
        display.complete("estimating")
    text = output.getvalue()
    for part in ("trial 1/2", "coherence θ 0.988", "M12 0.08370 ± 0.00021", "K22 6.9 ± 1.5"):
        assert part in text
    assert "20.0 s" in text
    assert "estimating" in text


def test_elsewhere_only_the_beginning_of_each_trial_is_told() -> None:
    output = io.StringIO()
    with Display(Console(file=output, width=120)) as display:
        for samples in (0, 10, 20_000):
            display.show(replace(SNAPSHOT, samples=samples))
    assert output.getvalue().count("trial 1/2") == 1
