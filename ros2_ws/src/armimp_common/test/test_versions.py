"""The git revision that a result was made with."""

from pathlib import Path

import pytest

from armimp_common import versions
from support.processes import run_program


def git(directory: Path, *arguments: str) -> str:
    identity = ["-c", "user.name=tester", "-c", "user.email=tester@example.org"]
    return run_program("git", "-C", str(directory), *identity, *arguments).strip()


def test_git_revision_tells_commit_and_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(versions, "__file__", str(tmp_path / "file"))
    git_revision = versions.git_revision
    assert git_revision() == "unknown", "no repository"
    git(tmp_path, "init", "--quiet")
    assert git_revision() == "unknown", "no commit"

    (tmp_path / "file").write_text("one")
    git(tmp_path, "add", "file")
    git(tmp_path, "commit", "--quiet", "--no-verify", "--message", "one")
    commit = git(tmp_path, "rev-parse", "HEAD")
    assert git_revision() == commit

    (tmp_path / "result").write_text("untracked files are no change of the sources")
    assert git_revision() == commit
    (tmp_path / "file").write_text("two")
    assert git_revision() == f"{commit}+dirty"
