"""Problems get the advice that fits, as the sentences are now."""

import errno
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from string import Formatter

import numpy as np
import pytest

from armimp_common.errors import BagError, DataError
from armimp_common.topics import TORQUE_SENSORS, TRIAL
from armimp_estimation import verdict
from armimp_estimation.alignment.assemble import assemble_trials
from armimp_estimation.alignment.gaps import GapConfig, judge_gaps
from armimp_estimation.bags import require_free_space
from armimp_estimation.bags.statuses import decode_trial_status
from armimp_estimation.bags.writer import why_not_written
from armimp_estimation.frf import order_trials
from armimp_estimation.problems import SENTENCES, Problem, ProblemCode
from armimp_estimation.report.advice import OTHER, advise
from armimp_estimation.report.formats import difference, number, percent, uncertain
from armimp_estimation.report.settings import ASSUMPTION, CHOSEN, assumptions_content, origin
from armimp_estimation.spectra import WelchConfig
from armimp_estimation.trial import TrialData
from support.results import METADATA
from support.synthetic_bags import Message, synthetic_recording
from support.synthetic_trials import TWO_JOINT_ARM, SyntheticConfig, synthetic_trial

LIMITS = verdict.Limits()
NAMES = ("shoulder", "elbow")
CONFIG = json.loads(METADATA["config"])


def kind(problem: str) -> str:
    ((advice, sentences),) = advise([problem])
    assert sentences == [problem]
    return advice.title


def test_problems_with_locking() -> None:
    found = verdict.judge_locking(NAMES, np.full((2, 2), 0.5), np.full((2, 2), 0.5), LIMITS)
    assert len(found) == 6
    assert {kind(str(one)) for one in found} == {"Joints that should have been held still moved"}


def test_problems_with_coherence() -> None:
    found = verdict.judge_coherence(NAMES, np.zeros(2), np.zeros((2, 2)), 0.25)
    assert len(found) == 4
    assert {kind(str(one)) for one in found} == {"A joint does not answer its perturbation"}


def test_problems_of_each_code_have_advice_unless_they_are_notes() -> None:
    notes = {
        ProblemCode.COMMANDS_PERMUTED,
        ProblemCode.DELAY_CORRECTED,
        ProblemCode.TIMING_REFUTED,
    }
    for code in set(ProblemCode) - notes:
        assert kind(filled(code).sentence) != "Other problems", code


def filled(code: ProblemCode) -> Problem:
    fields = {name: spec for _, name, spec, _ in Formatter().parse(SENTENCES[code]) if name}
    values = {name: 3 if spec == "d" else 1.5 if spec else "x" for name, spec in fields.items()}
    return Problem(code=code, values=values)


def assembled_problem(messages: Sequence[Message]) -> str:
    topics: dict[str, list[bytes]] = {}
    for topic, _, raw in messages:
        topics.setdefault(topic, []).append(raw)
    statuses = [decode_trial_status(raw) for raw in topics.pop(TRIAL)]
    (trial,) = assemble_trials(NAMES, topics, statuses)
    with pytest.raises(DataError) as caught:
        trial.require()
    return str(caught.value)


def test_problems_with_samples() -> None:
    messages = list(synthetic_recording(ticks=100).messages)
    torques = [i for i, (topic, *_) in enumerate(messages) if topic == TORQUE_SENSORS]
    lost = messages[: torques[50]] + messages[torques[50] + 1 :]
    twice = messages[: torques[50]] + messages[torques[50] :][:1] + messages[torques[50] :]
    for spoiled in (lost, twice):
        assert kind(assembled_problem(spoiled)) == "Samples are missing or in disorder"


def test_problems_with_the_disk_and_with_what_is_left_out() -> None:
    full = BagError(f"bag: cannot be written: {why_not_written(OSError(errno.ENOSPC, ''))}")
    assert kind(str(full)) == "There is no room on the disk"
    with pytest.raises(BagError) as caught:
        require_free_space(Path(), 10**18)
    assert kind(str(caught.value)) == "There is no room on the disk"
    topics: dict[str, list[bytes]] = {}
    for topic, _, raw in synthetic_recording(ticks=100).messages:
        topics.setdefault(topic, []).append(raw)
    statuses = [decode_trial_status(raw) for raw in topics.pop(TRIAL)]
    for intervals in ("", "10-40"):
        statuses[-1] = replace(statuses[-1], clipped=31, clipped_intervals=intervals)
        (trial,) = assemble_trials(NAMES, topics, statuses)
        (problem,) = judge_gaps(trial, GapConfig())
        assert kind(problem) == "Much of a trial is left out"


def test_problems_with_the_set_of_trials() -> None:
    loop = SyntheticConfig(rate=125.0, samples=3000)
    record = synthetic_trial(TWO_JOINT_ARM, 0, loop, 1)
    welch = WelchConfig(segment=1024, overlap=768)
    one = TrialData.from_record(record, welch)
    both = TrialData.from_record(replace(record, perturbation=record.perturbation + 1.0), welch)
    for trials in ([], [one], [one, one], [both, both]):
        with pytest.raises(DataError) as caught:
            order_trials(trials)
        assert kind(str(caught.value)) == "The trials do not make a whole"


def test_problems_with_a_short_record() -> None:
    record = synthetic_trial(TWO_JOINT_ARM, 0, SyntheticConfig(samples=100), 1)
    with pytest.raises(DataError) as caught:
        TrialData.from_record(record)
    assert kind(str(caught.value)) == "There are too few samples"


@pytest.mark.parametrize(
    ("problem", "title"),
    [
        ("interrupted by the user", "The run was stopped"),
        ("trial 1: aborted: operator pressed stop", "The run was stopped"),
        ("node arm_sim was killed by signal 9", "A node failed"),
        ("the moon is full", OTHER.title),
    ],
)
def test_problems_of_a_run(problem: str, title: str) -> None:
    assert kind(problem) == title


def test_problems_of_one_kind_come_together_in_their_order() -> None:
    found = advise(["node a died", "interrupted by the user", "node b died"])
    assert [(advice.title, problems) for advice, problems in found] == [
        ("A node failed", ["node a died", "node b died"]),
        ("The run was stopped", ["interrupted by the user"]),
    ]


def test_parameters_say_where_they_come_from() -> None:
    assert origin(CONFIG, "arm_sim", "arm.inertia") == "paper, Table I"
    assert origin(CONFIG, "arm_sim", "friction.coulomb") == ASSUMPTION
    assert origin(CONFIG, "arm_sim", "robot.masses") == ASSUMPTION
    assert origin(CONFIG, "imbic_controller", "target.damping") == ASSUMPTION
    assert origin(CONFIG, "imbic_controller", "law.gamma") == CHOSEN
    assert origin(CONFIG, "arm_sim", "joints") == ""


@pytest.mark.parametrize(("joints", "title"), [(3, "Third joint"), (5, "Arm")])
def test_of_more_than_two_joints_the_paper_says_nothing(joints: int, title: str) -> None:
    config = {"experiment": {"joints": joints}, "arm_sim": {}}
    assert ASSUMPTION in origin(config, "arm_sim", "arm.inertia")
    content = assumptions_content(config)
    assert content is not None
    assert content["assumptions"][0][0] == title


@pytest.mark.parametrize("config", [{}, {"experiment": "text"}, {"experiment": None}, {"a": [1]}])
def test_a_configuration_of_another_kind_is_taken_without_assumptions(
    config: dict[str, object],
) -> None:
    assert assumptions_content(config) is None
    assert origin(config, "arm_sim", "unheard_of") == ""


def test_an_error_gets_two_digits_and_the_estimate_as_many_decimals() -> None:
    assert uncertain(0.184406, 0.00069951) == "0.18441 ± 0.00070"
    assert uncertain(-7.98196, 0.24772) == "−7.98 ± 0.25"
    assert uncertain(1234.5, 35.8) == "1234 ± 36"
    assert uncertain(2.0, float("nan")) == "2 ± –"
    assert uncertain(float("nan"), 0.0) == "– ± –"


def test_what_is_not_a_number_is_a_dash() -> None:
    assert number(float("inf")) == percent(float("nan")) == difference(1.0, 0.0) == "–"
    assert difference(1.1, 1.0) == "+10.00\N{NARROW NO-BREAK SPACE}%"
    assert number(62.708, ".1f", "°") == "62.7°"
