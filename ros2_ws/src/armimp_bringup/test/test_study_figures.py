"""Figures of a study: the files, and what is drawn in them."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.study.conditions import Condition, select_conditions
from armimp_bringup.study.engine import Batch, ConditionResult, Provenance, run_batch
from armimp_bringup.study.entry import StudyEntry
from armimp_bringup.study.figures import (
    coherence_figure,
    impedance_figure,
    scores_figure,
    write_figures,
)
from armimp_bringup.study.study import run_study
from armimp_estimation.results import ImpedanceCurve

ESTIMATOR = "welch_siso"
BASE = ExperimentConfig(duration=10.0, estimators=(ESTIMATOR,))
CONDITIONS = select_conditions(["friction=0+3,resolution=1,perturbation=2"], "1")


class Results:
    """A back end that has the results already; gives their entries and curves as well."""

    workers = 1

    def __init__(self, results: Sequence[ConditionResult]) -> None:
        self._results = list(results)
        self.entries: list[StudyEntry] = [result.entry for result in results]

    def run(self, batches: Sequence[Batch]) -> Iterator[list[ConditionResult]]:
        for _ in batches:
            yield self._results

    def curves(self, condition: Condition) -> Mapping[str, ImpedanceCurve]:
        (result,) = [one for one in self._results if one.condition == condition]
        return {name: ImpedanceCurve.of(one) for name, one in result.results.items()}


@pytest.fixture(scope="module")
def results() -> Results:
    batch = Batch(base=BASE, conditions=CONDITIONS, provenance=Provenance.here())
    return Results(run_batch(batch))


def _labels(figure: Any) -> set[str]:
    (legend,) = figure.legends
    return {text.get_text() for text in legend.get_texts()}


@pytest.mark.slow
def test_every_figure_is_written_as_png_and_pdf_of_the_width_of_two_columns(
    results: Results, tmp_path: Path
) -> None:
    run_study(BASE, CONDITIONS, tmp_path, results)
    names = (f"fig2-{ESTIMATOR}-perturbation2", f"fig3-{ESTIMATOR}", f"fig4-{ESTIMATOR}")
    assert {path.name for path in tmp_path.glob("*.p*")} == {
        f"{name}.{suffix}" for name in names for suffix in ("png", "pdf")
    }
    for name in names:
        picture = (tmp_path / f"{name}.png").read_bytes()
        assert picture.startswith(b"\x89PNG\r\n\x1a\n")
        assert struct.unpack(">I", picture[16:20]) == (1432,)  # 7.16 inches of 200 points
        document = (tmp_path / f"{name}.pdf").read_bytes()
        assert document.startswith(b"%PDF-")
        assert b"CreationDate" not in document


@pytest.mark.slow
def test_figures_are_drawn_alike_when_they_are_drawn_again(
    results: Results, tmp_path: Path
) -> None:
    files = []
    for directory in (tmp_path / "one", tmp_path / "other"):
        directory.mkdir()
        written = write_figures(directory, results.entries[:1], results.curves)
        files.append([path.read_bytes() for path in written])
    assert files[0] == files[1]


def test_figure_2_shows_magnitude_phase_and_error_of_every_element(results: Results) -> None:
    figure = impedance_figure(results.entries, results.curves, ESTIMATOR)
    axes = figure.axes
    assert [one.get_ylabel() for one in axes] == [
        "magnitude\n(N·m/rad)",
        "phase (°)",
        "error (%)",
    ] * 4
    assert [one.get_title() for one in axes[::3]] == [
        "$Z_{11}$", "$Z_{12}$", "$Z_{21}$", "$Z_{22}$",
    ]  # fmt: skip
    assert {one.get_xlabel() for one in axes[2::3]} == {"frequency (Hz)"}
    assert [len(one.lines) for one in axes[:3]] == [3, 3, 2]  # two conditions, and the truth
    curve = results.curves(CONDITIONS[1])[ESTIMATOR]
    of_z21 = axes[6].lines[1]
    np.testing.assert_array_equal(of_z21.get_xdata(), curve.f)
    np.testing.assert_array_equal(of_z21.get_ydata(), np.abs(curve.Z[1, 0]))
    truth = results.entries[0].truth
    assert truth is not None
    np.testing.assert_array_equal(
        axes[6].lines[-1].get_ydata(), np.abs(truth.mbk().impedance(curve.f)[1, 0])
    )
    assert _labels(figure) == {"friction 0", "friction 3", "resolution 1", "truth"}


def test_phase_of_noise_does_not_jump_by_whole_turns(results: Results) -> None:
    figure = impedance_figure(results.entries, results.curves, ESTIMATOR)
    for phase in figure.axes[1::3]:
        for line in phase.lines:
            assert np.min(line.get_ydata()) > -90.0
            assert np.max(line.get_ydata()) < 270.0


@pytest.mark.parametrize(
    ("draw", "labels", "entries"),
    [
        (scores_figure, ["VAF (%)", "R²"], 4),
        (
            coherence_figure,
            [
                "derived coherence",
                r"coherence $\tau_\Delta \to \tau$",
                r"coherence $\tau_\Delta \to \theta$",
            ],
            6,
        ),
    ],
)
def test_figures_3_and_4_group_by_every_factor(
    results: Results, draw: Any, labels: list[str], entries: int
) -> None:
    figure = draw(results.entries, ESTIMATOR)
    panels = np.array(figure.axes).reshape(-1, 3)
    assert [row[0].get_ylabel() for row in panels] == labels
    assert [one.get_xlabel() for one in panels[-1]] == [
        "friction level", "resolution level", "perturbation level",
    ]  # fmt: skip
    assert [one.get_xticks().tolist() for one in panels[0]] == [[0, 3], [1], [2]]
    assert len(_labels(figure)) == entries + 1
    assert "target" in _labels(figure)


def test_marks_of_figure_3_are_means_and_bars_reach_from_worst_to_best(results: Results) -> None:
    panel = scores_figure(results.entries, ESTIMATOR).axes[
        1
    ]  # by resolution, of which there is one
    values = []
    for entry in results.entries:
        vaf = entry.estimators[ESTIMATOR].vaf
        assert vaf is not None
        values.append(vaf[0][1])
    container = panel.containers[1]
    np.testing.assert_allclose(container.lines[0].get_ydata(), [np.mean(values)])
    (segment,) = container.lines[2][0].get_segments()
    np.testing.assert_allclose(segment[:, 1], [min(values), max(values)])
