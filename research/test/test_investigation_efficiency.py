"""`make research ARGS=efficiency`: columns of their own times, errors against the bound."""

from __future__ import annotations

import numpy as np
import pytest

from armimp_bringup.offline import simulate
from research import efficiency
from research.efficiency import Case, columns, measure, until


def test_each_column_is_that_of_the_time_of_its_own_trial() -> None:
    early, late = np.zeros((3, 2, 2)), np.ones((3, 2, 2))
    np.testing.assert_array_equal(columns([early, late])[1], [[0.0, 1.0], [0.0, 1.0]])


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


@pytest.mark.slow
def test_an_experiment_that_ended_earlier_has_the_first_samples() -> None:
    config = Case(kind="multisine", voluntary=0.0).config.model_copy(update={"duration": 2.0})
    (whole,) = simulate([config])
    for one, part in zip(whole.records, until(whole, 0.5).records, strict=True):
        assert part.samples == 500
        assert part.command is not None
        np.testing.assert_array_equal(part.torque, one.torque[:, :500])
