"""`make bench ARGS=estimate`: reading and estimating bags is timed, and has a limit."""

import json

import pytest

from benchmarks import estimate
from benchmarks.__main__ import main

pytestmark = pytest.mark.slow


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
