"""What a report tells of the torque readings and of the tare."""

from __future__ import annotations

import html
from dataclasses import replace

import pytest

from armimp_estimation.report import Result, load_result, report_page
from support.results import METADATA, make_result


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Result:
    metadata = {
        **METADATA,
        "torque_timing": '"before_update"',
        "torque_delay": "0.002",
        "torque_cutoff": "200.0",
    }
    return load_result(make_result(tmp_path_factory.mktemp("late"), metadata=metadata))


def test_the_report_states_which_readings_were_corrected(result: Result) -> None:
    text = html.unescape(report_page(result))
    assert (
        "Torques were read just before each command takes effect, 2 ms late, "
        "through a Butterworth low-pass of order 1, 200 Hz."
    ) in text
    assert "All estimates are corrected for delay and low-pass" in text


def test_the_tare_of_a_trial_stands_beside_its_other_facts(result: Result) -> None:
    trials = []
    for one in result.trials:
        window = replace(one.window, tare=(0.8125, -0.5))
        trials.append(replace(one, window=window))
    assert "tare 0.812" not in report_page(result)
    assert "tare 0.812 N·m, −0.500 N·m" in html.unescape(
        report_page(replace(result, trials=tuple(trials)))
    ).replace("\u202f", " ").replace("\u00a0", " ")
