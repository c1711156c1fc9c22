"""`armimp reproduce`: exit status, what it prints, and one clear line for wrong usage."""

import json
from pathlib import Path
from signal import SIGINT, SIGTERM, Signals

import pytest
from psutil import Process

from armimp_bringup.study.scores import StudyVerdict
from armimp_bringup.terminal import describe
from armimp_common.versions import software
from support.command import Told, call, interrupted, program
from support.processes import wait_until
from support.results import read_study

SHORT = ("--duration", "4", "--no-figures", "--only", "friction=0,resolution=0,perturbation=3")


def _reproduce(directory: Path, *options: str) -> Told:
    return call("reproduce", "--out", str(directory), *options)


def test_study_that_misses_targets_exits_with_1_and_names_the_first_of_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("armimp_bringup.study.study._MOST_FAILURES", 2)
    # Four seconds are too short for targets that are meant for fifty.
    told = _reproduce(tmp_path / "out", *SHORT)
    assert told.status == 1
    assert "targets missed" in told.out
    assert f"study in {tmp_path / 'out'}" in told.out
    complaints = [line for line in told.err.splitlines() if line.startswith("armimp: ")]
    verdict = StudyVerdict.model_validate_json((tmp_path / "out" / "verdict.json").read_bytes())
    first, second, *others = verdict.failures()
    more = f"and {len(others)} more, see {tmp_path / 'out' / 'verdict.json'}"
    assert complaints == [f"armimp: {line}" for line in (first, second, more)]
    (entry,) = read_study(tmp_path / "out" / "study.json")
    assert list(entry.estimators) == ["welch_siso", "lpm_full"]
    assert entry.condition.name == "friction0-resolution0-perturbation3-seed0"


@pytest.mark.slow
@pytest.mark.parametrize("number", [SIGINT, SIGTERM])
def test_interrupted_study_ends_at_once(tmp_path: Path, number: Signals) -> None:
    options = ("--no-figures", "--seeds", "0:40", "--workers", "1", "--duration", "200")
    with program("reproduce", "--out", str(tmp_path / "out"), *options) as study:
        assert study.stderr is not None
        assert study.stderr.readline() == "0 of 1920 conditions\n"
        wait_until(lambda: len(Process(study.pid).children()) > 1, "a worker beside its tracker")
        worker = Process(study.pid).children()[-1]
        # It does not wait for the batch that is running.
        assert interrupted(study, 130, number) == ["armimp: interrupted"]
        assert not worker.is_running()


def test_a_file_decides_what_options_leave_open_and_an_estimator_without_targets_meets_them(
    tmp_path: Path,
) -> None:
    file = tmp_path / "study.yaml"
    file.write_text(
        "estimators: [welch_full]\nfriction: 2\nseed: 5\nduration: 99.0\n"
        "arm_sim: {voluntary: {rms: 0.2}}\n"
    )
    options = ("--config", str(file), "--json", "--seeds", "3:5", "--workers", "1")
    told = _reproduce(tmp_path / "out", *SHORT, *options)
    assert told.status == 0
    printed = json.loads(told.out)
    assert printed == json.loads((tmp_path / "out" / "verdict.json").read_text())
    assert printed["conditions"] == 2
    assert {one["estimator"] for one in printed["worst"]} == {"welch_full"}
    assert {one["met"] for one in printed["worst"]} == {None}
    assert "2 of 2 conditions" in told.err
    entries = read_study(tmp_path / "out" / "study.json")
    assert [(one.friction, one.seed) for one in entries] == [(0, 3), (0, 4)]
    assert [(trial.k, trial.ticks) for trial in entries[0].trials] == [(1, 4_000), (2, 4_000)]
    config = json.loads(json.dumps(entries[0].config))
    assert config["versions"] == software()["versions"]
    assert (config["experiment"]["seed"], config["experiment"]["duration"]) == (3, 4.0)
    assert config["arm_sim"]["voluntary.rms"] == 0.2


def test_time_left_follows_from_what_was_done_since_the_start() -> None:
    assert describe(0, 48, 3.0, things="conditions") == "0 of 48 conditions"
    assert describe(12, 48, 10.0, things="conditions") == "12 of 48 conditions, 30 s left"
    assert describe(48, 48, 65.0, things="conditions") == "48 of 48 conditions, took 1 min 5 s"
