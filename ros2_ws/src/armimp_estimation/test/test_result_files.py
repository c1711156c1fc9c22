import json
import math
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from armimp_common.errors import DataError
from armimp_estimation.identify import Identification, identify
from armimp_estimation.results import (
    EstimatorSummary,
    ImpedanceCurve,
    Summary,
    TrialLedger,
    TruthSummary,
    VerdictSummary,
    read_frf,
    read_summary,
    summarise,
    write_frf,
    write_summary,
)
from armimp_estimation.settings import IdentifyConfig
from armimp_estimation.spectra import WelchConfig
from armimp_estimation.trial import TrialData
from support.synthetic_trials import TWO_JOINT_ARM, SyntheticConfig, synthetic_trial

CONFIG = IdentifyConfig(welch=WelchConfig(segment=1024, overlap=768))
LEDGERS = {
    0: TrialLedger(bag="bags/trial_1", ticks=6144, rtf=3.125),
    1: TrialLedger(bag=None, ticks=6144, lost=2),
}


@pytest.fixture(scope="module")
def identification() -> Identification:
    loop = SyntheticConfig(rate=125.0, samples=6144, torque_noise=0.02)
    data = [
        TrialData.from_record(synthetic_trial(TWO_JOINT_ARM, joint, loop, 1), CONFIG.welch)
        for joint in range(2)
    ]
    return identify(data, ["welch_siso", "welch_full"], TWO_JOINT_ARM, CONFIG)


@pytest.fixture
def summary(identification: Identification) -> Summary:
    return summarise(identification, LEDGERS, config={"duration": 50.0, "a": [None]}, seed=1)


def test_summary_has_the_keys_of_schema_1(summary: Summary, tmp_path: Path) -> None:
    write_summary(tmp_path / "summary.json", summary)
    content = json.loads((tmp_path / "summary.json").read_text())
    keys = [
        "schema",
        "config",
        "joints",
        "joint_names",
        "seed",
        "valid",
        "problems",
        "verdict",
        "findings",
        "trials",
        "estimators",
    ]
    assert list(content) == [*keys, "truth", "timing", "wall", "torque_reading", "origin"]
    assert content["schema"] == 1
    assert content["config"] == {"duration": 50.0, "a": [None]}
    assert (content["joints"], content["seed"]) == (2, 1)
    assert (content["valid"], content["problems"]) == (True, [])
    assert [trial["k"] for trial in content["trials"]] == [1, 2]
    first, second = content["trials"]
    assert first["bag"] == "bags/trial_1"
    assert (first["ticks"], first["lost"], first["rtf"]) == (6144, 0, 3.125)
    assert (second["bag"], second["lost"], second["rtf"]) == (None, 2, None)
    assert len(first["lock_ratio"]) == len(first["bias_bound"]) == 2
    wanted = {"M", "B", "K", "M_se", "B_se", "K_se", "M_ci", "B_ci", "K_ci", "covariance"}
    wanted |= {"vaf", "r2"}
    wanted |= {"lack_of_fit", "lack_limit", "verdict", "delay", "models", "model"}
    wanted |= {"coherence_derived", "coherence_torque", "coherence_motion"}
    assert set(content["estimators"]) == {"welch_siso", "welch_full"}
    assert set(content["estimators"]["welch_siso"]) == wanted
    assert content["truth"]["K"] == TWO_JOINT_ARM.K.tolist()


def test_numbers_of_a_summary_come_back_bit_by_bit(
    identification: Identification, summary: Summary, tmp_path: Path
) -> None:
    path = tmp_path / "summary.json"
    write_summary(path, summary)
    back = read_summary(path)
    assert back.model_dump_json() == summary.model_dump_json()
    for name, result in identification.estimators.items():
        one = back.estimators[name]
        assert np.array(one.M).tobytes() == result.fit.mbk.M.tobytes()
        assert np.array(one.B_se).tobytes() == result.fit.B_se.tobytes()
        assert np.array(one.coherence_motion).tobytes() == result.coherence_motion.tobytes()
    assert back.truth is not None
    np.testing.assert_array_equal(back.truth.mbk().B, TWO_JOINT_ARM.B)


@given(st.lists(st.floats(), min_size=1, max_size=5))
def test_any_finite_number_comes_back_and_others_as_nan(values: list[float]) -> None:
    truth = TruthSummary(M=[values], B=[values], K=[values])
    text = truth.model_dump_json()
    assert "NaN" not in text
    assert "Infinity" not in text
    back = TruthSummary.model_validate_json(text)
    for value, read in zip(values, back.M[0], strict=True):
        if math.isfinite(value):
            assert (read, math.copysign(1.0, read)) == (value, math.copysign(1.0, value))
        else:
            assert math.isnan(read)


def test_problems_of_the_run_come_first_and_make_the_result_invalid(
    identification: Identification,
) -> None:
    summary = summarise(
        identification, LEDGERS, config={}, seed=None, problems=("torque was clipped 3 times",)
    )
    assert not summary.valid
    assert summary.problems == ["torque was clipped 3 times"]


def test_when_a_trial_has_no_ledger_expect_data_error(identification: Identification) -> None:
    with pytest.raises(DataError, match="trial of joint 2"):
        summarise(identification, {0: LEDGERS[0]}, config={}, seed=1)


def test_without_truth_vaf_and_truth_are_null(identification: Identification) -> None:
    result = identification.estimators["welch_siso"]
    one = EstimatorSummary.of(
        replace(result, vaf=None), VerdictSummary(impedance=True, parameters=False)
    )
    assert json.loads(one.model_dump_json())["vaf"] is None


@pytest.mark.parametrize("writer", ["summary", "frf"])
def test_when_the_file_exists_expect_an_error_and_the_file_untouched(
    writer: str, identification: Identification, summary: Summary, tmp_path: Path
) -> None:
    path = tmp_path / "file"
    path.write_text("precious")
    estimates = identification.estimators
    write = {
        "summary": lambda: write_summary(path, summary),
        "frf": lambda: write_frf(path, estimates),
    }[writer]
    with pytest.raises(DataError, match="file: exists already"):
        write()
    assert path.read_text() == "precious"
    assert list(tmp_path.iterdir()) == [path]


def test_when_the_directory_is_missing_expect_the_path_in_the_error(
    summary: Summary, tmp_path: Path
) -> None:
    with pytest.raises(DataError, match=r"nowhere/summary.json: cannot be written: No such file"):
        write_summary(tmp_path / "nowhere" / "summary.json", summary)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "content"),
        ("{", "content"),
        ("[]", "content"),
        ('{"schema": 2}', "schema"),
        ('{"schema": 1, "config": {}, "joints": "two"}', "joints"),
    ],
)
def test_when_the_file_is_no_summary_expect_file_and_place_in_one_line(
    text: str, message: str, tmp_path: Path
) -> None:
    path = tmp_path / "summary.json"
    path.write_text(text)
    with pytest.raises(DataError, match=f"summary.json: not a summary: {message}") as caught:
        read_summary(path)
    assert "\n" not in str(caught.value)


def test_when_a_summary_has_an_unknown_key_expect_data_error(
    summary: Summary, tmp_path: Path
) -> None:
    path = tmp_path / "summary.json"
    content = json.loads(summary.model_dump_json(by_alias=True)) | {"colour": "red"}
    path.write_text(json.dumps(content))
    with pytest.raises(DataError, match="colour"):
        read_summary(path)


def test_when_there_is_no_summary_expect_data_error(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"none.json: No such file"):
        read_summary(tmp_path / "none.json")


def test_curves_come_back_bit_by_bit(identification: Identification, tmp_path: Path) -> None:
    path = tmp_path / "frf.npz"
    write_frf(path, identification.estimators)
    back = read_frf(path)
    assert list(back) == ["welch_siso", "welch_full"]
    for name, result in identification.estimators.items():
        written, read = ImpedanceCurve.of(result), back[name]
        for one in fields(written):
            if one.name != "coherence":
                found, expected = getattr(read, one.name), getattr(written, one.name)
                np.testing.assert_array_equal(found, expected, strict=True)
        for one in fields(read.coherence):
            found, expected = getattr(read.coherence, one.name), getattr(result.coherence, one.name)
            np.testing.assert_array_equal(found, expected)


def test_covariances_of_responses_and_parameters_contain_the_standard_errors(
    identification: Identification,
) -> None:
    for result in identification.estimators.values():
        estimate, fit = result.estimate, result.fit
        assert estimate.disturbance is not None
        assert estimate.inverse is not None
        share = np.abs(estimate.inverse) ** 2
        variance = np.einsum("kiif,kjf->ijf", estimate.disturbance, share).real
        known = estimate.without_systematics().variance
        np.testing.assert_allclose(variance, known, rtol=1e-6)
        errors = np.concatenate([getattr(fit, f"{letter}_se").ravel() for letter in "MBK"])
        np.testing.assert_allclose(np.sqrt(np.diag(fit.covariance)), errors, rtol=1e-12)
        correlation = fit.covariance / np.outer(errors, errors)
        assert np.linalg.eigvalsh(correlation).min() > 0.0


def test_equal_curves_give_equal_files(identification: Identification, tmp_path: Path) -> None:
    for name in ("one", "two"):
        write_frf(tmp_path / f"{name}.npz", identification.estimators)
    assert (tmp_path / "one.npz").read_bytes() == (tmp_path / "two.npz").read_bytes()


def test_an_estimator_with_frequencies_of_its_own_keeps_them(
    identification: Identification, tmp_path: Path
) -> None:
    first = identification.estimators["welch_siso"]
    shifted = replace(first, estimate=replace(first.estimate, f=first.estimate.f + 1.0))
    path = tmp_path / "frf.npz"
    write_frf(path, {"welch_siso": first, "fine": shifted})
    back = read_frf(path)
    np.testing.assert_array_equal(back["fine"].f, first.estimate.f + 1.0)
    np.testing.assert_array_equal(back["welch_siso"].f, first.estimate.f)


def test_when_there_is_no_curve_expect_data_error(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no estimate"):
        write_frf(tmp_path / "frf.npz", {})


@pytest.mark.parametrize("content", [b"", b"nonsense", b"PK\x03\x04 cut"])
def test_when_the_file_holds_no_curves_expect_its_name_in_the_error(
    content: bytes, tmp_path: Path
) -> None:
    path = tmp_path / "frf.npz"
    path.write_bytes(content)
    with pytest.raises(DataError, match=r"frf.npz: not a file of impedance curves"):
        read_frf(path)


def test_when_an_array_is_missing_expect_data_error(tmp_path: Path) -> None:
    path = tmp_path / "frf.npz"
    np.savez(path, f=np.ones(2), Z_x=np.ones((1, 1, 2)))
    with pytest.raises(DataError, match="T_x"):
        read_frf(path)
