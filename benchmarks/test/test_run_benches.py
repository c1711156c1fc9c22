"""`make bench` of runs, of estimates and of the study: structure and sanity of the figures."""

import json
from types import ModuleType
from typing import Any

import pytest

from benchmarks import estimate, growth, study
from benchmarks.__main__ import main

pytestmark = pytest.mark.slow

# Measurements as short as they can be, and a target that nothing can meet.
BENCHES: dict[str, tuple[ModuleType, dict[str, Any], list[str]]] = {
    "growth": (
        growth,
        {"CASES": ((1, 10.0),)},
        ["ticks per second", "outside of", "resident size", "bag of a trial", "to result"],
    ),
    "estimate": (
        estimate,
        {"SAMPLES": 10_000, "_REPEATS": 1, "TARGET": 1e-9},
        ["reading the bag", "welch_siso alone", "lpm_full alone", "bag to result"],
    ),
    "study": (
        study,
        {"TRIAL": 10.0, "_SCALAR": 0.02, "_BATCH": 0.02, "_REPEATS": 1, "TARGET": 1e-9},
        ["one lane, per core", "lanes, per core", "over many", "busy", "estimates", "study of"],
    ),
}


@pytest.mark.parametrize("name", BENCHES)
def test_a_benchmark_prints_its_figures_and_misses_a_target_that_nothing_meets(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    module, changes, expected = BENCHES[name]
    for constant, value in changes.items():
        monkeypatch.setattr(module, constant, value)
    assert main([name, "--json"]) == ("TARGET" in changes)
    figures = json.loads(capsys.readouterr().out)["benchmarks"][name]
    assert all(part in one["label"] for part, one in zip(expected, figures, strict=True))
    assert all(one["value"] > 0.0 for one in figures)
    missed = [one for one in figures if one["limit"] and not one["met"]]
    assert missed == figures[-1:] * ("TARGET" in changes)
