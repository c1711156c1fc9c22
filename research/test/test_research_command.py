"""The command line of the studies refuses in one line, and leaves nothing behind."""

from __future__ import annotations

from pathlib import Path

import pytest

from research.__main__ import main

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
