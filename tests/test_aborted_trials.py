"""Bags of a trial that was aborted: refused, or estimated up to there on request, as not valid."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from armimp_bringup.cli import main
from armimp_common.status import Phase
from armimp_common.topics import PERIOD_NS
from armimp_estimation.bags.files import BAGS
from armimp_estimation.curves import FRF_FILE
from armimp_estimation.problems import ProblemCode
from armimp_estimation.recorder import TrialRecorder
from armimp_estimation.summary import SUMMARY_FILE, read_summary
from support.recordings import recorded_arm
from support.streams import record

pytestmark = pytest.mark.usefixtures("environment")

BEFORE = 7000
"""Samples of the second trial before it is aborted."""
REASON = "arm_sim is dead"


def aborted_bags(directory: Path) -> list[str]:
    arm = recorded_arm()
    names = arm.records[0].joint_names
    end_ns = arm.records[1].start_ns + BEFORE * PERIOD_NS
    recording = TrialRecorder(names, directory, {"joint_names": json.dumps(names)}, lambda *_: None)
    record(recording, (message for message in arm.messages if message[1] < end_ns))
    last = recording.status
    assert last is not None
    assert last.phase is Phase.PERTURB
    recording.add_status(replace(last, phase=Phase.ABORTED, valid=False, reason=REASON))
    recording.stop()
    return [str(path) for path in sorted((directory / BAGS).iterdir())]


@pytest.mark.parametrize("command", ["estimate", "replay"])
def test_without_the_option_the_reason_is_one_line(
    tmp_path: Path, command: str, capfd: pytest.CaptureFixture[str]
) -> None:
    bags = aborted_bags(tmp_path)
    assert main([command, *bags]) == 1
    told = [line for line in capfd.readouterr().err.splitlines() if line.startswith("armimp: ")]
    assert told == [
        f"armimp: {bags[1]}: trial 2: aborted: {REASON}; --allow-gaps uses the intact parts"
    ]


@pytest.mark.slow
def test_with_the_option_it_is_estimated_up_to_there_but_not_valid(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    bags = aborted_bags(tmp_path)
    for command in ("estimate", "replay"):
        assert main([command, *bags, "--allow-gaps", "--out", str(tmp_path / command)]) == 1
        assert f"not valid: trial 2: aborted: {REASON}" in capfd.readouterr().err

    offline, replayed = (tmp_path / command for command in ("estimate", "replay"))
    assert (offline / FRF_FILE).read_bytes() == (replayed / FRF_FILE).read_bytes()
    one, other = read_summary(offline / SUMMARY_FILE), read_summary(replayed / SUMMARY_FILE)
    assert one.estimators == other.estimators
    assert one.problems[0].code is ProblemCode.TRIAL_ABORTED
    assert (one.problems[0].trial, one.problems[0].values) == (2, {"reason": REASON})
    assert BEFORE - 2 <= one.trials[1].ticks <= BEFORE
