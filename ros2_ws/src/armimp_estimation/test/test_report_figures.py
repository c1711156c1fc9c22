"""Figures for papers: there, of the right size, and equal for equal results."""

from pathlib import Path

import pytest

from armimp_common.errors import DataError
from armimp_estimation.figures import TWO_COLUMNS, impedance_figure, write_figures
from armimp_estimation.result import Result, load_result
from support.results import METADATA, make_result
from support.synthetic_bags import synthetic_recording


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Result:
    return load_result(make_result(tmp_path_factory.mktemp("figures") / "good"))


@pytest.mark.slow
def test_figures_are_written_as_png_and_pdf_the_same_each_time(
    result: Result, tmp_path: Path
) -> None:
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        write_figures(tmp_path / name, result)
    first = {path.name: path.read_bytes() for path in (tmp_path / "one").iterdir()}
    assert set(first) == {
        f"{name}.{form}" for name in ("impedance", "coherence", "traces") for form in ("png", "pdf")
    }
    for name, content in first.items():
        assert content.startswith(b"\x89PNG" if name.endswith("png") else b"%PDF")
        assert content == (tmp_path / "two" / name).read_bytes()


def test_a_figure_fits_its_columns_and_nothing_is_cut_off(result: Result) -> None:
    figure = impedance_figure(result.summary, result.curves)
    width = figure.get_figwidth()
    assert width == TWO_COLUMNS
    assert len(figure.axes) == 12
    needed = figure.get_tightbbox()
    assert needed.x0 >= 0.0
    assert needed.y0 >= 0.0
    assert needed.x1 <= width
    assert needed.y1 <= figure.get_figheight()


def test_without_an_estimate_the_traces_alone_are_drawn_whatever_the_joints_are_called(
    tmp_path: Path,
) -> None:
    recording = synthetic_recording(joint_names=("$x", "<b>_{"), ticks=3000)
    metadata = {**METADATA, "truth": "null"}
    directory = make_result(tmp_path / "one", messages=recording.messages, metadata=metadata)
    (tmp_path / "figures").mkdir()
    write_figures(tmp_path / "figures", load_result(directory))
    assert {path.name for path in (tmp_path / "figures").iterdir()} == {"traces.png", "traces.pdf"}


def test_when_a_figure_cannot_be_written_expect_its_path_in_the_error(
    result: Result, tmp_path: Path
) -> None:
    with pytest.raises(DataError, match=r"nowhere/impedance.png: cannot be written: No such file"):
        write_figures(tmp_path / "nowhere", result)
