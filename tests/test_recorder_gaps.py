"""Bags with gaps on the command line and through the graph: refused, or the intact parts used."""

import json
from pathlib import Path

import pytest

from armimp_bringup.cli import main
from armimp_common.topics import PERIOD_NS, TORQUE_SENSORS
from armimp_estimation.bags.files import BAGS
from armimp_estimation.curves import FRF_FILE
from armimp_estimation.recorder import TrialRecorder
from armimp_estimation.summary import SUMMARY_FILE, read_summary
from support.recordings import recorded_arm
from support.streams import record

pytestmark = pytest.mark.usefixtures("environment")

LOST = range(2500, 2537)


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Recordings of two trials, of which the second has a gap."""
    directory = tmp_path_factory.mktemp("recorded")
    arm = recorded_arm()
    start_ns = arm.records[1].start_ns
    lost = {start_ns + tick * PERIOD_NS for tick in LOST}
    names = arm.records[0].joint_names
    metadata = {"joint_names": json.dumps(names)}
    recording = TrialRecorder(names, directory, metadata, lambda *_: None)
    record(recording, (m for m in arm.messages if m[0] != TORQUE_SENSORS or m[1] not in lost))
    recording.stop()
    return [str(path) for path in sorted((directory / BAGS).iterdir())]


@pytest.mark.parametrize("command", ["estimate", "replay"])
def test_without_the_option_the_reason_is_one_line(
    bags: list[str], command: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main([command, *bags]) == 1
    told = [line for line in capfd.readouterr().err.splitlines() if line.startswith("armimp: ")]
    assert told == [
        f"armimp: {bags[1]}: trial 2: samples of torque_sensors are missing: 37, between 2.500 s "
        "and 2.537 s; --allow-gaps uses the intact parts"
    ]


@pytest.mark.slow
def test_with_the_option_replayed_and_offline_results_are_the_same_to_the_bit(
    bags: list[str], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    for command in ("estimate", "replay"):
        assert main([command, *bags, "--allow-gaps", "--out", str(tmp_path / command)]) == 0
        shown = capfd.readouterr().out
        assert "excluded" in shown
        assert "0.37 %" in shown
        assert "duplicated" not in shown

    offline, replayed = (tmp_path / command for command in ("estimate", "replay"))
    assert (offline / FRF_FILE).read_bytes() == (replayed / FRF_FILE).read_bytes()
    one, other = read_summary(offline / SUMMARY_FILE), read_summary(replayed / SUMMARY_FILE)
    assert one.estimators == other.estimators
    for mine, theirs in zip(one.trials, other.trials, strict=True):
        assert mine.streams == theirs.streams
        assert (mine.lost, mine.excluded, mine.stretches) == (
            theirs.lost,
            theirs.excluded,
            theirs.stretches,
        )
    assert (one.trials[1].lost, one.trials[1].excluded, one.trials[1].stretches) == (37, 37, 2)
    page = (offline / "report.html").read_text(encoding="utf-8")
    assert "Left out of all estimates" in page
    assert "samples of torque_sensors are missing: 37, between 2.500 s and 2.537 s" in page
