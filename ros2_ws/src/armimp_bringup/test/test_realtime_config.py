"""What a user says about time, and what the nodes make of it."""

from __future__ import annotations

from typing import Any

import pytest

from armimp_bringup import realtime_bench
from armimp_bringup.config import ExperimentConfig, Overrides, load_config, node_parameters
from armimp_bringup.realtime_bench import time_realtime
from armimp_common.errors import ConfigurationError
from armimp_common.jitter import TimingFigures, TimingLimits
from armimp_estimation.realtime_timing import TimingRecord
from armimp_estimation.results import Summary


def test_in_real_time_both_nodes_are_told_and_each_gets_a_process() -> None:
    config = load_config(None, {"mode": "realtime", "priority": 20})
    parameters = node_parameters(config, None)
    assert config.processes == "separate"
    for node in (parameters.simulator, parameters.controller):
        assert (node.mode, node.realtime.priority, node.realtime.cpu) == ("realtime", 20, -1)


def test_one_process_for_all_can_be_had_in_real_time_too() -> None:
    assert load_config(None, {"mode": "realtime", "processes": "composed"}).processes == "composed"
    assert ExperimentConfig().processes == "composed"


def test_parameters_of_single_nodes_prevail() -> None:
    overrides: Overrides = {"realtime": {"priority": 7, "cpu": 1}}
    config = ExperimentConfig(mode="realtime", priority=20, arm_sim=overrides)
    parameters = node_parameters(config, None)
    assert (parameters.simulator.realtime.priority, parameters.simulator.realtime.cpu) == (7, 1)
    assert parameters.controller.realtime.priority == 20


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"priority": 20}, "priority = 20 is for mode realtime"),
        (
            {"mode": "realtime", "imbic_controller": {"mode": "lockstep"}},
            "arm_sim: parameter 'mode' is 'realtime', that of imbic_controller 'lockstep'",
        ),
        ({"mode": "realtime", "arm_sim": {"realtime.spin": 0.1}}, "realtime.spin"),
    ],
)
def test_what_does_not_fit_together_is_refused_in_one_line(
    options: dict[str, Any], complaint: str
) -> None:
    with pytest.raises(ConfigurationError, match=complaint) as caught:
        node_parameters(ExperimentConfig.model_validate(options), None)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("options", [{"mode": "soon"}, {"mode": "realtime", "priority": 100}])
def test_values_that_do_not_exist_are_refused_in_one_line(options: dict[str, Any]) -> None:
    with pytest.raises(ConfigurationError) as caught:
        load_config(None, options)
    assert "\n" not in str(caught.value)


class TestBenchmark:
    @pytest.fixture
    def told(self) -> list[str]:
        return []

    def run(self, monkeypatch: pytest.MonkeyPatch, result: Summary | Exception) -> None:
        def run_experiment(config: ExperimentConfig, directory: object) -> Summary:
            assert config.mode == "realtime"
            if isinstance(result, Exception):
                raise result
            return result

        monkeypatch.setattr(realtime_bench, "run_experiment", run_experiment)

    def test_figures_are_those_of_the_run_without_what_was_not_measured(
        self, monkeypatch: pytest.MonkeyPatch, told: list[str]
    ) -> None:
        figures = TimingFigures(ticks=200, late=1, missed=4, period_p50=1e-3, latency_max=3e-3)
        summary = Summary(
            config={},
            joints=1,
            joint_names=["elbow"],
            seed=None,
            valid=False,
            problems=["no use"],
            trials=[],
            estimators={},
            truth=None,
            timing=TimingRecord(figures=figures, limits=TimingLimits()).summary,
        )
        self.run(monkeypatch, summary)

        found = {one.key: one.value for one in time_realtime(told.append)}

        expected = {"ticks": 200, "late": 0.5, "missed": 2.0, "period_p50": 1.0, "latency_max": 3.0}
        assert found == {
            f"{kind}_{key}": pytest.approx(value)
            for kind in ("ordinary", "fifo")
            for key, value in expected.items()
        }
        assert "ordinary scheduling: no use" in told

    def test_what_the_system_does_not_permit_is_told_and_left_out(
        self, monkeypatch: pytest.MonkeyPatch, told: list[str]
    ) -> None:
        self.run(monkeypatch, ConfigurationError("priority = 50: not permitted"))
        assert time_realtime(told.append) == []
        assert "priority = 50: not permitted" in told
