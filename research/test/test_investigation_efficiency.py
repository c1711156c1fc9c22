"""`make research ARGS=efficiency`: columns of their own times, errors against the bound."""

from __future__ import annotations

import pytest

from research import efficiency
from research.efficiency import Case, measure


@pytest.mark.slow
def test_errors_are_near_the_bound_and_longer_trials_have_smaller_ones(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = []
    for times in ((60.0, 60.0), (15.0, 15.0)):
        monkeypatch.setattr(efficiency, "TIMES", times)
        found.append(measure(Case(kind="noise", voluntary=0.3), range(8), 1))
    long, short = found
    assert 0.5 < long["K1_over_bound"] < 2.0
    assert long["K1_60s"] < short["K1_15s"]
    assert long["angle_1"] > 20.0
