"""The report and its figures: what they say, that they stand alone, and can't be subverted."""

import base64
import hashlib
import re
from dataclasses import replace
from pathlib import Path

import pytest

from armimp_common import topics
from armimp_estimation.figures import write_figures
from armimp_estimation.problems import ProblemCode, problem
from armimp_estimation.report.formats import difference, digits, number, percent, plain, uncertain
from armimp_estimation.report.run import REPORT_FILE, report_page, write_report
from armimp_estimation.result import Result, load_result
from armimp_estimation.summary import Summary
from support.pages import Page
from support.results import METADATA, make_result, with_cuff
from support.streams import changed
from support.synthetic_bags import recorded_arm, synthetic_recording

HOSTILE = "\"'><script>alert(1)</script><img src=x onerror=alert(1)><a href='javascript:alert(1)'>"


@pytest.fixture(scope="module")
def directory(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_result(tmp_path_factory.mktemp("report") / "good")


@pytest.fixture(scope="module")
def result(directory: Path) -> Result:
    return load_result(directory)


@pytest.fixture(scope="module")
def page(result: Result) -> Page:
    return Page(report_page(result))


def words_of(result: Result, **changes: object) -> str:
    """Words of the page of a result, some of whose summary is changed."""
    summary = result.summary.model_copy(update=changes)
    return Page(report_page(replace(result, summary=summary))).words


def test_a_valid_result_is_called_so_first(page: Page) -> None:
    headings = [attributes for tag, attributes in page.elements if tag == "h2"]
    assert headings[0] == {"id": "verdict-title"}
    assert "Valid Both trials are complete, the held joints stayed still" in page.words
    assert "beyond" not in page.words


def test_every_section_is_there_and_the_contents_lead_to_all(page: Page) -> None:
    sections = [attributes["id"] for tag, attributes in page.elements if tag == "section"]
    links = [a["href"] for tag, a in page.elements if tag == "a" and a.get("href") != "#content"]
    assert links == [f"#{name}" for name in sections]
    assert sections == [
        *("verdict", "parameters", "scores", "impedance", "coherence"),
        *("locking", "samples", "signals", "settings", "assumptions"),
    ]


def test_estimates_stand_beside_their_errors_and_the_truth(page: Page, result: Result) -> None:
    one = result.summary.estimators["welch_siso"]
    value, error = one.M[0][0], one.M_se[0][0]
    interval = " to ".join(number(end, digits(error)) for end in one.M_ci[0][0])
    cells = f"M 11 0.187 {uncertain(value, error)} {interval} {difference(value, 0.187)}"
    assert " ".join(cells.split()) in page.words
    assert "true value" in page.words
    assert "Simulation" in page.words


def test_without_truth_there_is_no_word_of_simulation_and_the_relative_error_is_shown(
    result: Result,
) -> None:
    estimators = {name: changed(one, vaf=None) for name, one in result.summary.estimators.items()}
    words = words_of(result, truth=None, config={}, estimators=estimators)
    assert "relative s.e." in words
    assert "imulat" not in words
    assert "VAF" not in words
    assert "they were made elsewhere" in words


def test_account_of_samples_and_configuration_are_shown(page: Page) -> None:
    shown = (
        "joint angles joint_states 10000 10000 0 0 0",
        "torque commands effort_controller/commands 10000 10000 0 – –",
        "friction.coulomb 1, 1",
        "law.gamma 90",
        "python 3.12.0",
        "git revision 0123abc",
        "LuGre friction of level 2",
        "seed 5",
    )
    assert [words for words in shown if words not in page.words] == []


def test_the_page_needs_nothing_but_itself(page: Page) -> None:
    assert_harmless(page)
    for tag, attributes in page.elements:
        assert tag not in {"link", "object", "embed"}
        assert "src" not in attributes


def test_no_script_may_run_but_the_two_that_belong_to_it(page: Page) -> None:
    (policy,) = [
        attributes["content"] or ""
        for tag, attributes in page.elements
        if attributes.get("http-equiv") == "Content-Security-Policy"
    ]
    runnable = [text for given, text in page.scripts if "type" not in given]
    assert len(runnable) == 2
    digests = [base64.b64encode(hashlib.sha256(one.encode()).digest()).decode() for one in runnable]
    allowed = " ".join(f"'sha256-{digest}'" for digest in digests)
    assert policy.startswith("default-src 'none'; ")
    assert f"script-src {allowed};" in policy
    assert "http" not in policy


def test_the_file_is_written_whole_and_replaces_an_older_one(
    result: Result, tmp_path: Path
) -> None:
    (tmp_path / REPORT_FILE).write_text("old")
    path = write_report(tmp_path, result)
    assert path.read_text(encoding="utf-8") == report_page(result, tmp_path.name)
    assert [file.name for file in tmp_path.iterdir()] == [REPORT_FILE]
    assert path.stat().st_size < 6.5e6


def test_an_invalid_result_says_why_and_what_to_do(result: Result) -> None:
    found = problem(
        ProblemCode.LOCK_RATIO, name="elbow", perturbed="shoulder", percent=9.0, limit=2.0
    )
    words = words_of(result, problems=[found])
    assert "Not valid: 1 problem " in words
    assert "Joints that should have been held still moved" in words
    sentence = found.sentence.replace("(limit 2 %)", "").strip()
    assert sentence in words.replace("\N{NO-BREAK SPACE}", " ")
    assert "What to do:" in words
    assert "do not use them as a result" in words


def test_what_only_another_estimator_needs_is_marked_so_and_not_claimed(result: Result) -> None:
    summary = result.summary
    trials = [changed(one, lock_ratio=[0.1, 0.1], bias_bound=[0.6, 0.6]) for one in summary.trials]
    siso = changed(summary.estimators["welch_siso"], decides=False)
    estimators = {**summary.estimators, "welch_siso": siso}
    words = words_of(result, trials=trials, estimators=estimators)
    assert "Valid Both trials are complete, each joint answers its perturbation, and" in words
    assert words.count("not needed by welch_full") == 2 + 6
    assert "beyond" not in words


def test_parameters_of_the_model_stand_beside_m_b_and_k(result: Result) -> None:
    estimators = {name: with_cuff(one) for name, one in result.summary.estimators.items()}
    words = words_of(result, estimators=estimators)
    assert "Model cuff of the arm, by welch_siso: Z = A + B parameter" in words
    assert "M 12 " in words.partition("Model cuff of the arm")[2]
    assert "cuff_stiffness 1 200000.00 ± 0.50 u cuff_stiffness 2 10000 ± – u delay 0.01 ±" in words


def test_a_result_without_an_estimate_still_has_a_report(tmp_path: Path) -> None:
    messages = list(recorded_arm().messages)
    # The torque sensor falls silent in the second trial.
    torques = [i for i, (topic, *_) in enumerate(messages) if topic == topics.TORQUE_SENSORS]
    gone = set(torques[-3000:-2000])
    kept = [message for i, message in enumerate(messages) if i not in gone]
    result = load_result(make_result(tmp_path / "gap", messages=kept))
    page = Page(report_page(result))

    assert not result.summary.valid
    assert result.summary.estimators == {}
    assert "Nothing could be estimated" in page.words
    assert "Samples are missing or in disorder" in page.words
    assert re.search(r"torques on the arm torque_sensors \d+ \d+ 1000 0 0", page.words)
    assert "Not usable: trial 2: samples of torque_sensors are missing: 1000" in page.words
    figures = [a["id"] for tag, a in page.elements if tag == "figure"]
    assert figures == ["trace-1", "trace-2"]


def test_a_bag_that_is_not_there_is_told(directory: Path, tmp_path: Path) -> None:
    for name in ("summary.json", "frf.npz"):
        (tmp_path / name).write_bytes((directory / name).read_bytes())
    result = load_result(tmp_path)
    words = words_of(result)
    assert result.trials == ()
    assert "no time traces: " in words
    assert f"{result.summary.joint_names[0]} perturbed joint angles" in words


def hostile_summary(summary: Summary) -> Summary:
    """The summary with the payload wherever it has a string."""
    (first, *_) = summary.estimators.values()
    trials = [changed(trial, bag=HOSTILE) for trial in summary.trials]
    return summary.model_copy(
        update={
            "valid": False,
            "problems": [problem(ProblemCode.NODE_FAILED, reason=f"node {HOSTILE} died")],
            "trials": trials,
            "estimators": {HOSTILE: first, **summary.estimators},
            "config": {
                HOSTILE: {HOSTILE: HOSTILE, "list": [HOSTILE, [HOSTILE]], "deep": {"a": HOSTILE}},
                "text": HOSTILE,
                "experiment": {"friction": HOSTILE, "joints": HOSTILE, "arm_sim": HOSTILE},
                "arm_sim": {"joints": [HOSTILE, HOSTILE], "friction.coulomb": HOSTILE},
                "versions": HOSTILE,
            },
        }
    )


def test_hostile_strings_in_a_summary_stay_text(result: Result) -> None:
    hostile = replace(result, summary=hostile_summary(result.summary))
    page = Page(report_page(hostile, HOSTILE))

    assert HOSTILE in page.words
    assert_harmless(page)


def assert_harmless(page: Page) -> None:
    assert {tag for tag, _ in page.elements}.isdisjoint({"img", "svg", "iframe", "base"})
    assert len([given for given, _ in page.scripts if "type" not in given]) == 2
    for tag, attributes in page.elements:
        assert not [name for name in attributes if name.startswith("on")], tag
        assert (attributes.get("href") or "#").startswith("#")


@pytest.mark.parametrize("value", ["a\x00b", "a\x1bb", "a\x7fb", "a\u202eb", "a\u2066b"])
def test_characters_which_deceive_are_shown_as_replaced(value: str) -> None:
    assert plain(value) == "a\N{REPLACEMENT CHARACTER}b"


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


@pytest.mark.slow
def test_figures_are_written_as_png_and_pdf_the_same_each_time(
    result: Result, tmp_path: Path
) -> None:
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        write_figures(tmp_path / name, result)
    for name in ("impedance", "coherence", "traces"):
        for form, begin in (("png", b"\x89PNG"), ("pdf", b"%PDF")):
            first, second = (tmp_path / one / f"{name}.{form}" for one in ("one", "two"))
            assert first.read_bytes() == second.read_bytes()
            assert first.read_bytes().startswith(begin)


def test_without_an_estimate_the_traces_alone_are_drawn_whatever_the_joints_are_called(
    tmp_path: Path,
) -> None:
    recording = synthetic_recording(joint_names=("$x", "<b>_{"), ticks=3000)
    metadata = {**METADATA, "truth": "null"}
    directory = make_result(tmp_path / "one", messages=recording.messages, metadata=metadata)
    (tmp_path / "figures").mkdir()
    write_figures(tmp_path / "figures", load_result(directory))
    assert {path.name for path in (tmp_path / "figures").iterdir()} == {"traces.png", "traces.pdf"}
