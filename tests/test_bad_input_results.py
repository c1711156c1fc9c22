"""Files of results, damaged in every way: each is named with its fault."""

import copy
import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.study import read_study, select_conditions
from armimp_bringup.study.engine import threads
from armimp_bringup.study.study import run_study
from armimp_common.errors import DataError
from armimp_estimation.summary import read_frf

BASE = ExperimentConfig(duration=4.0, estimators=("welch_full",))
ONLY = "friction=0,resolution=0,perturbation=3"
CONDITIONS = select_conditions([ONLY], "0")
NAME = CONDITIONS[0].name
ESTIMATOR = ("estimators", "welch_full")


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("study") / "good"
    run_study(BASE, CONDITIONS, directory, threads(1), figures=False)
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
    spoiled = copy.deepcopy(result)
    place: Any = spoiled
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    file.write_text(json.dumps([spoiled]))
    told = reason_against(read_study, file)
    assert told.startswith(f"{file}: ")
    assert words in told
    assert len(told) < 800


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
    good = np.load(study / "conditions" / f"{NAME}.npz")
    np.savez(file, **{**good, **arrays})
    assert words in reason_against(read_frf, file)


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
