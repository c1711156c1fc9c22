"""The command line of the studies refuses in one line, and leaves nothing behind."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import pytest

from armimp_bringup.config import ExperimentConfig
from research import coverage, growth, limits
from research.__main__ import main
from research.options import InvestigationOptions

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("arguments", "quoted"),
    [
        (["nothing"], "'nothing'"),
        (["coverage", "--workers", "0"], "got 0"),
        (["coverage", "--seeds", "0:5:0"], "'0:5:0'"),
    ],
)
def test_wrong_usage_is_named_and_leaves_no_directory(
    arguments: list[str], quoted: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*arguments, "--out", str(tmp_path / "new")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert quoted in line
    assert not list(tmp_path.iterdir())


def test_nothing_is_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "thesis.tex").write_text("ten years of work")
    assert main(["limits", "--out", str(tmp_path)]) == 2
    assert "is not empty" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


SHORT = ExperimentConfig(duration=16.4, arm_sim={"substeps": 10})


@pytest.mark.parametrize(
    ("name", "investigate", "plan", "rows"),
    [
        (
            "coverage",
            coverage.investigate,
            coverage.CoveragePlan(base=SHORT, levels=((3, 3, 3),), voluntary=(0.3, 0.0)),
            4 * 12,
        ),
        ("limits", limits.investigate, limits.LimitsPlan(base=SHORT, levels=((3, 3, 3),)), 4 * 12),
        ("growth", growth.investigate, growth.GrowthPlan(base=SHORT, joints=(2,)), 3),
    ],
)
def test_a_study_leaves_tables_and_a_figure(
    name: str, investigate: Any, plan: Any, rows: int, tmp_path: Path
) -> None:
    assert investigate(InvestigationOptions(out=tmp_path, seeds="0:3", workers=2), plan) == 0
    result = json.loads((tmp_path / f"{name}.json").read_text(encoding="utf-8"))
    assert result["seeds"] == "0:3"
    with (tmp_path / f"{name}.csv").open(encoding="utf-8", newline="") as stream:
        assert len(list(csv.DictReader(stream))) >= rows
    assert (tmp_path / f"{name}.png").stat().st_size > 10_000
    assert (tmp_path / f"{name}.pdf").stat().st_size > 5_000
