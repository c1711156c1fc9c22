"""`make bench ARGS=study`: figures that are positive and consistent, and the file."""

from __future__ import annotations

import json

import pytest

from armimp_bringup.bench import available_cores
from benchmarks import study
from benchmarks.__main__ import main
from benchmarks.study import TARGET

pytestmark = pytest.mark.slow


@pytest.fixture
def brief(monkeypatch: pytest.MonkeyPatch) -> None:
    """Measurements as short as they can be."""
    for name, value in (("TRIAL", 10.0), ("_SCALAR", 0.02), ("_BATCH", 0.02), ("_REPEATS", 1)):
        monkeypatch.setattr(study, name, value)


@pytest.mark.usefixtures("brief")
def test_study_is_timed_in_one_lane_in_many_and_as_a_whole(
    capsys: pytest.CaptureFixture[str],
) -> None:
    status = main(["study", "--json"])
    told = capsys.readouterr()
    record = json.loads(told.out)
    assert record["schema"] == 1
    assert record["machine"]["cores"] == available_cores() >= 1
    assert "numpy" in record["versions"]
    figures = record["benchmarks"]["study"]
    values = {key: one["value"] for key, one in figures.items()}
    assert set(values) == {
        "scalar_trial", "batch_trial", "speed_up", "loaded_trial", "estimate", "study",
    }  # fmt: skip
    assert all(value > 0.0 for value in values.values())
    assert values["speed_up"] == pytest.approx(values["scalar_trial"] / values["batch_trial"])
    # 96 trials in blocks, some lanes of which may be idle, and 48 conditions to estimate.
    shared = 96 * values["loaded_trial"] + 48 * values["estimate"]
    assert values["study"] >= 0.99 * shared / available_cores()
    assert figures["study"]["limit"] == TARGET
    assert status == (0 if values["study"] <= TARGET else 1)
    assert "compiling" in told.err
