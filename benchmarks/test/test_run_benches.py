"""`make bench ARGS=start`, `memory` and `growth`: structure and sanity of their figures."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from armimp_common.errors import GraphError
from benchmarks import growth
from benchmarks.__main__ import main
from benchmarks.command_run import run_command

pytestmark = pytest.mark.slow

Measure = Callable[[str], tuple[int, dict[str, Any]]]


@pytest.fixture
def measure(capsys: pytest.CaptureFixture[str]) -> Measure:
    """Run a benchmark; gives its status and figures."""

    def run(name: str) -> tuple[int, dict[str, Any]]:
        status = main([name, "--json"])
        figures: dict[str, Any] = json.loads(capsys.readouterr().out)["benchmarks"][name]
        return status, figures

    return run


def test_a_real_run_is_measured(measure: Measure, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(growth, "CASES", ((1, 10.0),))
    _, figures = measure("growth")
    values = {key.removeprefix("1_joints_10_s_"): one["value"] for key, one in figures.items()}
    assert values["rate"] > 100.0
    assert values["outside"] > 0.1
    assert 50.0 < values["memory"] < 2000.0
    assert 0.1 < values["bag"] < 100.0
    assert values["estimate"] > 0.0


def test_when_a_run_has_no_result_expect_its_last_words(tmp_path: Path) -> None:
    with pytest.raises(GraphError, match=r"ended without result: armimp: .*'friction' = 9"):
        run_command(tmp_path / "out", "--friction", "9")
