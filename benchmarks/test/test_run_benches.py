"""`make bench` of runs, of estimates and of the study: structure and sanity of the figures."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from armimp_common.errors import GraphError
from benchmarks import estimate, growth, study
from benchmarks.__main__ import main
from benchmarks.command_run import run_command
from benchmarks.study import TARGET

pytestmark = pytest.mark.slow


def test_a_real_run_is_measured(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(growth, "CASES", ((1, 10.0),))
    main(["growth", "--json"])
    figures = json.loads(capsys.readouterr().out)["benchmarks"]["growth"]
    values = {key.removeprefix("1_joints_10_s_"): one["value"] for key, one in figures.items()}
    assert values["rate"] > 100.0
    assert values["outside"] > 0.1
    assert 50.0 < values["memory"] < 2000.0
    assert 0.1 < values["bag"] < 100.0
    assert values["estimate"] > 0.0


def test_when_a_run_has_no_result_expect_its_last_words(tmp_path: Path) -> None:
    with pytest.raises(GraphError, match=r"ended without result: armimp: .*'friction' = 9"):
        run_command(tmp_path / "out", "--friction", "9")


# --- `make bench ARGS=estimate`: reading and estimating bags is timed, and has a limit ----------


def test_reading_and_estimating_are_timed_against_the_limit(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(estimate, "SAMPLES", 10_000)
    monkeypatch.setattr(estimate, "_REPEATS", 1)
    monkeypatch.setattr(estimate, "TARGET", 1e-9)

    # A target that nothing can meet makes the exit status 1.
    assert main(["estimate", "--json"]) == 1

    figures = json.loads(capsys.readouterr().out)["benchmarks"]["estimate"]
    assert list(figures) == ["read", "welch_siso", "lpm_full", "trial"]
    assert all(one["value"] > 0.0 for one in figures.values())
    assert (figures["trial"]["limit"], figures["trial"]["met"]) == (1e-9, False)
    assert figures["read"]["limit"] is None


# --- `make bench ARGS=study`: figures that are positive and consistent, and the file ------------


def test_study_is_timed_in_one_lane_in_many_and_as_a_whole(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # Measurements as short as they can be.
    for name, value in (("TRIAL", 10.0), ("_SCALAR", 0.02), ("_BATCH", 0.02), ("_REPEATS", 1)):
        monkeypatch.setattr(study, name, value)
    status = main(["study", "--json"])
    told = capsys.readouterr()
    record = json.loads(told.out)
    figures = record["benchmarks"]["study"]
    values = {key: one["value"] for key, one in figures.items()}
    assert set(values) == {
        "scalar_trial", "batch_trial", "speed_up", "loaded_trial", "estimate", "study",
    }  # fmt: skip
    assert all(value > 0.0 for value in values.values())
    assert figures["study"]["limit"] == TARGET
    assert status == (0 if values["study"] <= TARGET else 1)
    assert "compiling" in told.err
