"""Figures 2 to 4 of the paper from a study, as PNG and PDF."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from armimp_bringup.study.conditions import LEVELS, Condition
from armimp_bringup.study.entry import StudyEntry
from armimp_bringup.study.levels import (
    LevelScore,
    Subject,
    coherence_scores,
    fit_scores,
    statistics,
)
from armimp_bringup.study.store import replace_file
from armimp_estimation.report.curves import deviation_percent, phase_about
from armimp_estimation.results import ImpedanceCurve

Curves = Callable[[Condition], Mapping[str, ImpedanceCurve]]

# Colours by Okabe and Ito, which colour-blind readers can tell apart.
_COLOURS: Final = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
_STYLES: Final = ("-", "--", "-.", ":")
_MARKERS: Final = ("o", "s", "^", "D", "v", "P", "X", "<", ">")
_WIDTH: Final = 7.16  # inches, two columns of a journal
_LEAST_PANEL: Final = 2.3  # inches; with many joints Figure 2 is a poster
_DPI: Final = 200
_LEGEND_COLUMNS: Final = 8
_STYLE: Final[Any] = {
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.labelsize": 8,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "lines.markersize": 3.5,
    "pdf.fonttype": 42,  # embedded as TrueType, as journals ask for
}


def write_figures(directory: Path, entries: Sequence[StudyEntry], curves: Curves) -> list[Path]:
    """Draw every figure for each estimator, and write it as PNG and PDF.

    Parameters
    ----------
    directory : Path
        Where to.
    entries : sequence of StudyEntry
        Results, at least one. Figure 2 shows those with the first seed.
    curves : callable
        Gives the curves of a condition.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    StudyError, DataError
        If curves can't be read, or a figure not be written.
    """
    import matplotlib as mpl

    written = []
    with mpl.rc_context(_STYLE):
        for name, figure in _figures(entries, curves):
            # Once is enough for both files.
            figure.get_layout_engine().execute(figure)
            figure.set_layout_engine("none")
            # The time of day would make every file another one.
            for suffix, metadata in (("png", None), ("pdf", {"CreationDate": None})):
                path = directory / f"{name}.{suffix}"
                save = functools.partial(figure.savefig, dpi=_DPI, metadata=metadata)
                replace_file(path, save)
                written.append(path)
    return written


def figure_title(name: str) -> str:
    """What the file of a figure shows."""
    number, estimator, *level = name.partition(".")[0].split("-")
    shown = {
        "fig2": "impedance in all conditions over the truth",
        "fig3": "VAF and R² by level",
        "fig4": "coherences by level",
    }[number]
    at = f", perturbation level {level[0].removeprefix('perturbation')}" if level else ""
    return f"{shown}, {estimator}{at}"


def impedance_figure(entries: Sequence[StudyEntry], curves: Curves, estimator: str) -> Any:
    """Fig. 2: true and estimated transfer-function matrix at one perturbation level.

    Parameters
    ----------
    entries : sequence of StudyEntry
        Of one perturbation level and seed; all are overlaid.
    curves : callable
        Gives the curves of a condition.
    estimator : str
        Name of the estimator.

    Returns
    -------
    matplotlib.figure.Figure
        For each element magnitude (N·m/rad), phase (degrees) and the relative error (%), without
        which all curves would look like one.
    """
    from matplotlib.figure import Figure

    n = entries[0].joints
    width = max(_WIDTH, _LEAST_PANEL * n)
    figure = Figure(figsize=(width, min(3.3, width / n) * n), layout="constrained")
    parts = figure.subfigures(n, n, squeeze=False)
    axes = [
        [part.subplots(3, 1, sharex=True, height_ratios=(3, 2, 2)) for part in row] for row in parts
    ]
    for entry in entries:
        curve = curves(entry.condition)[estimator]
        truth = _truth(entry, curve)
        look: dict[str, Any] = {
            "color": _COLOURS[entry.friction],
            "linestyle": _STYLES[entry.resolution],
            "linewidth": 0.8,
        }
        for i in range(n):
            for k in range(n):
                _bode(axes[i][k], curve.f, curve.Z[i, k], truth[i, k], look)
    last = curves(entries[-1].condition)[estimator]
    truth = _truth(entries[-1], last)
    for i in range(n):
        for k in range(n):
            look = {"color": "black", "linestyle": (0, (4, 3)), "linewidth": 1.1}
            magnitude, phase, _ = axes[i][k]
            magnitude.loglog(last.f, np.abs(truth[i, k]), **look)
            phase.semilogx(last.f, np.degrees(np.unwrap(np.angle(truth[i, k]))), **look)
            _finish_bode(axes[i][k], f"$Z_{{{i + 1}{k + 1}}}$")
    _impedance_legend(figure, entries)
    return figure


def scores_figure(entries: Sequence[StudyEntry], estimator: str) -> Any:
    """Fig. 3: VAF and R² by friction, resolution and perturbation level.

    Marks are means over all conditions with that level, bars reach from the worst to the best.

    Parameters
    ----------
    entries : sequence of StudyEntry
        Results.
    estimator : str
        Name of the estimator.

    Returns
    -------
    matplotlib.figure.Figure
    """
    return _grouped(entries, fit_scores(entries, estimator))


def coherence_figure(entries: Sequence[StudyEntry], estimator: str) -> Any:
    """Fig. 4: mean coherences by friction, resolution and perturbation level.

    Marks and bars as in :func:`scores_figure`.

    Parameters
    ----------
    entries : sequence of StudyEntry
        Results.
    estimator : str
        Name of the estimator, which the derived coherence depends on.

    Returns
    -------
    matplotlib.figure.Figure
    """
    return _grouped(entries, coherence_scores(entries, estimator))


def _figures(entries: Sequence[StudyEntry], curves: Curves) -> Iterator[tuple[str, Any]]:
    seed = entries[0].seed
    for estimator in entries[0].estimators:
        for level in LEVELS["perturbation"]:
            shown = [e for e in entries if (e.perturbation, e.seed) == (level, seed)]
            if shown:
                name = f"fig2-{estimator}-perturbation{level}"
                yield name, impedance_figure(shown, curves, estimator)
        yield f"fig3-{estimator}", scores_figure(entries, estimator)
        yield f"fig4-{estimator}", coherence_figure(entries, estimator)


def _truth(entry: StudyEntry, curve: ImpedanceCurve) -> NDArray[np.complex128]:
    assert entry.truth is not None  # these are simulations
    return entry.truth.mbk().impedance(curve.f)


def _bode(
    axes: Any,
    f: NDArray[np.float64],
    z: NDArray[np.complex128],
    truth: NDArray[np.complex128],
    look: Mapping[str, Any],
) -> None:
    magnitude, phase, error = axes
    magnitude.loglog(f, np.abs(z), **look)
    phase.semilogx(f, phase_about(truth, z), **look)
    error.loglog(f, deviation_percent(truth, z), **{**look, "linewidth": 0.5})


def _finish_bode(axes: Any, title: str) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, MultipleLocator, NullFormatter

    magnitude, phase, error = axes
    magnitude.set_title(title)
    magnitude.set_ylabel("magnitude\n(N·m/rad)")
    phase.set_ylabel("phase (°)")
    error.set_ylabel("error (%)")
    error.set_xlabel("frequency (Hz)")
    phase.yaxis.set_major_locator(MultipleLocator(45))
    error.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    error.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    error.xaxis.set_minor_formatter(NullFormatter())
    for one in axes:
        one.grid(visible=True, which="major", alpha=0.3, linewidth=0.4)
        one.margins(x=0.01)


def _impedance_legend(figure: Any, entries: Sequence[StudyEntry]) -> None:
    from matplotlib.lines import Line2D

    frictions = sorted({entry.friction for entry in entries})
    resolutions = sorted({entry.resolution for entry in entries})
    by_friction = [
        Line2D([], [], color=_COLOURS[level], linewidth=1.5, label=f"friction {level}")
        for level in frictions
    ]
    by_resolution = [
        Line2D([], [], color="0.4", linestyle=_STYLES[level], label=f"resolution {level}")
        for level in resolutions
    ]
    # Legends are filled column by column: friction above resolution.
    pairs = itertools.zip_longest(by_friction, by_resolution)
    handles = [handle for pair in pairs for handle in pair if handle is not None]
    handles.append(Line2D([], [], color="black", linestyle=(0, (4, 3)), lw=1.1, label="truth"))
    figure.legend(
        handles=handles,
        loc="outside lower center",
        ncols=(len(handles) + 1) // 2,
        frameon=False,
        handlelength=2.6,
    )


def _grouped(entries: Sequence[StudyEntry], scores: Sequence[LevelScore]) -> Any:
    """Rows of scores, columns of factors; in each panel means and ranges by level."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_WIDTH, 0.55 + 1.55 * len(scores)), layout="constrained")
    axes = figure.subplots(len(scores), len(LEVELS), sharey="row", squeeze=False)
    looks = list(dict.fromkeys(subject for score in scores for subject in score.values))
    for row, score in enumerate(scores):
        for column, factor in enumerate(LEVELS):
            panel = axes[row, column]
            present = _draw_levels(panel, entries, factor, score, looks)
            if score.limit is not None:
                panel.axhline(score.limit, color="0.45", linewidth=0.8, linestyle=(0, (5, 3)))
            panel.set_xticks(present)
            panel.set_xlim(min(present) - 0.5, max(present) + 0.5)
            panel.grid(visible=True, axis="y", alpha=0.3, linewidth=0.4)
            panel.ticklabel_format(axis="y", useOffset=False)
            if column == 0:
                panel.set_ylabel(_score_label(score))
            if row == len(scores) - 1:
                panel.set_xlabel(f"{factor} level")
    _grouped_legend(figure, axes, any(score.limit is not None for score in scores))
    return figure


def _score_label(score: LevelScore) -> str:
    named = score.name.replace("τΔ → τ", r"$\tau_\Delta \to \tau$")
    named = named.replace("τΔ → θ", r"$\tau_\Delta \to \theta$")
    return f"{named} ({score.unit})" if score.unit else named


def _subject_label(subject: Subject) -> str:
    symbol = subject.symbol.replace("θ", r"\theta").replace("·", r"\cdot")
    return f"${symbol}_{{{subject.indices}}}$"


def _draw_levels(
    panel: Any,
    entries: Sequence[StudyEntry],
    factor: str,
    score: LevelScore,
    looks: Sequence[Subject],
) -> list[int]:
    """Draw means and ranges, alike for a subject in all panels; returns the levels."""
    spread = 0.5 if len(score.values) <= 4 else 0.8
    present: list[int] = []
    for number, (subject, values) in enumerate(score.values.items()):
        look = looks.index(subject)
        found = statistics(entries, factor, values)
        present = found.levels.tolist()
        shift = spread * ((number + 0.5) / len(score.values) - 0.5)
        reach = np.array([found.mean - found.low, found.high - found.mean])
        panel.errorbar(
            found.levels + shift,
            found.mean,
            # Rounding may leave the mean of equal values beside them.
            yerr=np.maximum(reach, 0.0),
            color=_COLOURS[look % len(_COLOURS)],
            marker=_MARKERS[look % len(_MARKERS)],
            linestyle="none",
            elinewidth=0.9,
            label=_subject_label(subject),
        )
    return present


def _grouped_legend(figure: Any, axes: Any, limits: bool) -> None:
    from matplotlib.lines import Line2D

    handles: dict[str, Any] = {}
    for panel in axes[:, 0]:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    if limits:
        handles["target"] = Line2D([], [], color="0.45", linewidth=0.8, linestyle=(0, (5, 3)))
    figure.legend(
        handles.values(),
        handles.keys(),
        loc="outside lower center",
        ncols=min(len(handles), _LEGEND_COLUMNS),
        frameon=False,
    )
