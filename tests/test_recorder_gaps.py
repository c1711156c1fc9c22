"""Bags of trials with gaps, or that were aborted: refused, or used as far as they go on request."""

import json
from pathlib import Path

import pytest

from armimp_bringup.cli import main
from armimp_common.status import Phase
from armimp_common.topics import PERIOD_NS, TORQUE_SENSORS
from armimp_estimation.bags.reader import BAGS
from armimp_estimation.problems import ProblemCode
from armimp_estimation.recorder import TrialRecorder
from armimp_estimation.summary import FRF_FILE, SUMMARY_FILE, read_summary
from support.streams import changed, record
from support.synthetic_bags import recorded_arm

pytestmark = pytest.mark.usefixtures("environment")

LOST = range(2500, 2537)
BEFORE = 7000
"""Samples of the second trial before it is aborted."""
REASON = "arm_sim is dead"
MISSING = "samples of torque_sensors are missing: 37, between 2.500 s and 2.537 s"
Bags = dict[str, list[str]]


def recorder(directory: Path) -> TrialRecorder:
    names = recorded_arm().records[0].joint_names
    return TrialRecorder(names, directory, {"joint_names": json.dumps(names)}, lambda *_: None)


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> Bags:
    """Recordings of two trials, of which the second has a gap, or is aborted."""
    arm = recorded_arm()
    start_ns = arm.records[1].start_ns
    gaps, aborted = tmp_path_factory.mktemp("gaps"), tmp_path_factory.mktemp("aborted")
    recording = recorder(gaps)
    lost = {start_ns + tick * PERIOD_NS for tick in LOST}
    record(recording, (m for m in arm.messages if m[0] != TORQUE_SENSORS or m[1] not in lost))
    recording.stop()
    recording = recorder(aborted)
    record(recording, (m for m in arm.messages if m[1] < start_ns + BEFORE * PERIOD_NS))
    last = recording.status
    assert last is not None
    assert last.phase is Phase.PERTURB
    recording.add_status(changed(last, phase=Phase.ABORTED, valid=False, reason=REASON))
    recording.stop()
    return {
        kind: [str(path) for path in sorted((directory / BAGS).iterdir())]
        for kind, directory in (("gaps", gaps), ("aborted", aborted))
    }


@pytest.mark.parametrize("command", ["estimate", "replay"])
@pytest.mark.parametrize(("kind", "reason"), [("gaps", MISSING), ("aborted", f"aborted: {REASON}")])
def test_without_the_option_the_reason_is_one_line(
    bags: Bags, kind: str, reason: str, command: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main([command, *bags[kind]]) == 1
    told = [line for line in capfd.readouterr().err.splitlines() if line.startswith("armimp: ")]
    assert told == [
        f"armimp: {bags[kind][1]}: trial 2: {reason}; --allow-gaps uses the intact parts"
    ]


@pytest.mark.slow
def test_with_the_option_an_aborted_trial_is_estimated_up_to_there_but_not_valid(
    bags: Bags, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    results = [tmp_path / command for command in ("estimate", "replay")]
    for out in results:
        assert main([out.name, *bags["aborted"], "--allow-gaps", "--out", str(out)]) == 1
    offline, replayed = ((out / FRF_FILE).read_bytes() for out in results)
    assert offline == replayed
    one, other = (read_summary(out / SUMMARY_FILE) for out in results)
    assert one.estimators == other.estimators
    assert capfd.readouterr().err.count(f"not valid: trial 2: aborted: {REASON}") == 2
    assert one.problems[0].code is ProblemCode.TRIAL_ABORTED
    assert (one.problems[0].trial, one.problems[0].values) == (2, {"reason": REASON})
    assert BEFORE - 2 <= one.trials[1].ticks <= BEFORE
