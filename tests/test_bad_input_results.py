"""Files of results, damaged in every way: each is named with its fault."""

import copy
import io
import json
import os
import random
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.study import read_study, select_conditions
from armimp_bringup.study.engine import Threads
from armimp_bringup.study.scores import judge, results_table
from armimp_bringup.study.study import run_study
from armimp_common.errors import DataError
from armimp_estimation.summary import read_frf, read_summary

BASE = ExperimentConfig(duration=4.0, estimators=("welch_full",))
ONLY = "friction=0,resolution=0,perturbation=3"
CONDITIONS = select_conditions([ONLY], "0")
NAME = CONDITIONS[0].name
ESTIMATOR = ("estimators", "welch_full")


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("study") / "good"
    run_study(BASE, CONDITIONS, directory, Threads(1), figures=False)
    return directory


@pytest.fixture(scope="module")
def result(study: Path) -> dict[str, Any]:
    (read,) = json.loads((study / "study.json").read_bytes())
    assert isinstance(read, dict)
    return read


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A study to spoil."""
    return tmp_path / "study.json"


def with_value(result: dict[str, Any], path: tuple[str | int, ...], value: object) -> bytes:
    spoiled = copy.deepcopy(result)
    place: Any = spoiled
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    return json.dumps([spoiled]).encode()


NO_JSON = {
    "empty": b"",
    "deep": b"[" * 100_000,
    "text": b'"list"',
    "many digits": b"9" * 5000,
    "foreign": b'{"name": "armimp", "version": 3}',
    "half a pair": b'{"\\ud800": 1}',
}


@pytest.mark.parametrize("kind", NO_JSON)
def test_what_is_no_study_is_named(kind: str, file: Path) -> None:
    file.write_bytes(NO_JSON[kind])
    assert reason_against(read_study, file).startswith(f"{file}: not a study: ")


MATRIX = [[1.0, 2.0], [3.0]]


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        (("schema",), 2, "schema"),
        (("joints",), 3, "for 3 joints"),
        (("joints",), 10**30, "for 1000000000000000000000000000000 joints"),
        (("seed",), 1.5, "seed"),
        (("trials", 0, "k"), -1, "trials.0.k = -1 is none of 2 joints"),
        (("trials", 0, "lock_ratio"), [], "trials.0.lock_ratio does not have the shape (2,)"),
        (("trials", 1, "bias_bound"), [1.0], "trials.1.bias_bound does not have the shape (2,)"),
        (("truth", "K"), MATRIX, "truth: not three matrices"),
        ((*ESTIMATOR, "M"), [[]], "estimators.welch_full.M does not have the shape (2, 2)"),
        ((*ESTIMATOR, "B"), MATRIX, "estimators.welch_full.B does not have the shape (2, 2)"),
        ((*ESTIMATOR, "colour"), "red", "colour"),
    ],
)
def test_a_wrong_value_in_a_result_is_named(
    path: tuple[str | int, ...], value: object, words: str, result: dict[str, Any], file: Path
) -> None:
    file.write_bytes(with_value(result, path, value))
    told = reason_against(read_study, file)
    assert told.startswith(f"{file}: ")
    assert words in told
    assert len(told) < 800


@pytest.mark.parametrize("number", [None, -1e-300])
def test_numbers_that_are_unknown_or_absurd_fail_the_verdict(
    number: float | None, result: dict[str, Any], file: Path
) -> None:
    file.write_bytes(with_value(result, (*ESTIMATOR, "M"), [[number, 1.0], [1.0, 1.0]]))
    found = read_study(file)
    assert judge(found, results_table(found)).conditions == 1


def archive(file: Path, **arrays: Any) -> bytes:
    content = io.BytesIO()
    np.savez(content, **{**np.load(file), **arrays})
    return content.getvalue()


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"f": np.zeros(0)}, "frequencies of welch_full"),
        ({"f": np.array([2.0, 1.0])}, "frequencies of welch_full"),
        ({"Z_welch_full": np.zeros(3)}, "Z_welch_full has shape (3,)"),
        ({"Z_welch_full": np.array([{}], dtype=object)}, "allow_pickle"),
        ({"averages_welch_full": np.zeros(3)}, "averages_welch_full has shape (3,)"),
    ],
)
def test_wrong_arrays_of_curves_are_named(
    arrays: dict[str, Any], words: str, study: Path, tmp_path: Path
) -> None:
    file = tmp_path / "frf.npz"
    file.write_bytes(archive(study / "conditions" / f"{NAME}.npz", **arrays))
    assert words in reason_against(read_frf, file)


READERS = [read_frf, read_summary, read_study]


@pytest.mark.parametrize("read", READERS)
def test_what_is_no_regular_file_is_not_waited_for(
    read: Callable[[Path], object], tmp_path: Path
) -> None:
    pipe, hole = tmp_path / "pipe", tmp_path / "hole"
    os.mkfifo(pipe)
    with hole.open("wb") as file:
        file.write(b"[")
        file.truncate(1 << 40)
    assert reason_against(read, pipe).endswith("is not a regular file")
    assert "of 1099511627776 bytes" in reason_against(read, hole)
    assert reason_against(read, Path("/dev/zero")).endswith("is not a regular file")


def test_curves_that_unfold_beyond_reason_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "frf.npz"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive_file:
        for i in range(65):
            archive_file.writestr(f"Z_{i}.npy", bytes(8 << 20))
    assert file.stat().st_size < 10_000_000
    assert "it holds 545259520 bytes" in reason_against(read_frf, file)


def reason_against(read: Callable[[Path], object], file: Path) -> str:
    """The line with which a file is refused; empty if it is read."""
    try:
        read(file)
    except DataError as error:
        (line,) = str(error).splitlines()
        return line
    return ""


def changed_curves(study: Path, file: Path, rounds: int, *, seed: int) -> int:
    """How many of so many damaged copies are refused; no other error may come."""
    whole = (study / "conditions" / f"{NAME}.npz").read_bytes()
    rng = random.Random(seed)
    refused = 0
    for number in range(rounds):
        content = bytearray(whole[: len(whole) * number // rounds] if number % 2 else whole)
        for _ in range(0 if number % 2 else rng.choice([1, 3, 30])):
            # Headers are at the beginning, the directory of the archive is at the end.
            where = rng.choice([rng.randrange(len(whole)), rng.randrange(300)])
            content[rng.choice([where, -1 - where])] = rng.randrange(256)
        file.write_bytes(content)
        reason = reason_against(read_frf, file)
        refused += bool(reason)
        assert reason.startswith(f"{file}: not a file of impedance curves: " if reason else "")
    return refused


def changed_summaries(study: Path, file: Path, rounds: int, *, seed: int) -> int:
    """Likewise, of summaries."""
    entry = json.loads((study / "conditions" / f"{NAME}.json").read_bytes())
    levels = ("friction", "resolution", "perturbation")
    text = json.dumps({key: value for key, value in entry.items() if key not in levels})
    file.write_text(text)
    assert read_summary(file).joints == 2
    rng = random.Random(seed)
    refused = 0
    for _ in range(rounds):
        where = rng.randrange(len(text))
        part = rng.choice(["", "[", "]", "{", "null", "1e999", "NaN", '"', ",", "\0", "-"])
        file.write_text(text[:where] + part + text[where + rng.randrange(8) :])
        reason = reason_against(read_summary, file)
        refused += bool(reason)
        assert reason.startswith(f"{file}: not a summary: " if reason else "")
    return refused


def test_changed_bytes_are_read_or_refused(study: Path, tmp_path: Path) -> None:
    assert changed_curves(study, tmp_path / "frf.npz", 300, seed=1) > 150
    assert changed_summaries(study, tmp_path / "summary.json", 300, seed=1) > 150
