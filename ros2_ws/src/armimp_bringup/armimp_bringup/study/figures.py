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
from armimp_bringup.study.store import replace_file
from armimp_bringup.study.verdict import targets
from armimp_estimation.results import ImpedanceCurve

Curves = Callable[[Condition], Mapping[str, ImpedanceCurve]]

# Colours by Okabe and Ito, which colour-blind readers can tell apart.
_COLOURS: Final = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
_STYLES: Final = ("-", "--", "-.", ":")
_MARKERS: Final = ("o", "s", "^", "D", "v", "P", "X", "<", ">")
_WIDTH: Final = 7.16  # inches, two columns of a journal
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
    figure = Figure(figsize=(_WIDTH, 3.3 * n), layout="constrained")
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
    limits = targets(entries[0].joints).get(estimator, {})
    rows = (
        ("VAF (%)", _elements(entries, estimator, "vaf"), limits.get("VAF")),
        ("R²", _elements(entries, estimator, "r2"), limits.get("R²")),
    )
    return _grouped(entries, rows)


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
    limits = targets(entries[0].joints).get(estimator, {})
    n = entries[0].joints
    motion = {
        f"$\\theta_{k + 1}$": np.array(
            [e.estimators[estimator].coherence_motion[k] for e in entries]
        )
        for k in range(n)
    }
    rows = (
        (
            "derived coherence",
            _elements(entries, estimator, "coherence_derived"),
            limits.get("derived coherence"),
        ),
        (
            r"coherence $\tau_\Delta \to \tau$",
            _elements(entries, estimator, "coherence_torque"),
            None,
        ),
        (r"coherence $\tau_\Delta \to \theta$", motion, None),
    )
    return _grouped(entries, rows)


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
    # Counted from the truth on, so that noise cannot make it jump by a turn.
    angle = np.unwrap(np.angle(truth)) + np.angle(z / truth)
    phase.semilogx(f, np.degrees(angle), **look)
    error.loglog(f, 100.0 * np.abs(z / truth - 1.0), **{**look, "linewidth": 0.5})


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


def _elements(
    entries: Sequence[StudyEntry], estimator: str, score: str
) -> dict[str, NDArray[np.float64]]:
    """Values over the entries by label of the element."""
    n = entries[0].joints
    matrices = np.array([getattr(entry.estimators[estimator], score) for entry in entries])
    return {
        f"$Z_{{{i + 1}{k + 1}}}$": matrices[:, i, k].astype(np.float64)
        for i in range(n)
        for k in range(n)
    }


def _grouped(
    entries: Sequence[StudyEntry],
    rows: Sequence[tuple[str, Mapping[str, NDArray[np.float64]], float | None]],
) -> Any:
    """Rows of scores, columns of factors; in each panel means and ranges by level."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_WIDTH, 0.55 + 1.55 * len(rows)), layout="constrained")
    axes = figure.subplots(len(rows), len(LEVELS), sharey="row", squeeze=False)
    looks = list(dict.fromkeys(label for _, lines, _ in rows for label in lines))
    for row, (label, lines, limit) in enumerate(rows):
        for column, factor in enumerate(LEVELS):
            panel = axes[row, column]
            levels = np.array([getattr(entry, factor) for entry in entries])
            _draw_levels(panel, levels, lines, looks)
            if limit is not None:
                panel.axhline(limit, color="0.45", linewidth=0.8, linestyle=(0, (5, 3)))
            panel.set_xticks(sorted(set(levels.tolist())))
            panel.set_xlim(np.min(levels) - 0.5, np.max(levels) + 0.5)
            panel.grid(visible=True, axis="y", alpha=0.3, linewidth=0.4)
            panel.ticklabel_format(axis="y", useOffset=False)
            if column == 0:
                panel.set_ylabel(label)
            if row == len(rows) - 1:
                panel.set_xlabel(f"{factor} level")
    _grouped_legend(figure, axes, any(limit is not None for _, _, limit in rows))
    return figure


def _draw_levels(
    panel: Any,
    levels: NDArray[np.int64],
    lines: Mapping[str, NDArray[np.float64]],
    looks: Sequence[str],
) -> None:
    """Means and ranges by level; what looks alike in other panels has the same label there."""
    present = np.unique(levels)
    spread = 0.5 if len(lines) <= 4 else 0.8
    for number, (label, values) in enumerate(lines.items()):
        look = looks.index(label)
        groups = [values[levels == level] for level in present]
        means = np.array([np.mean(group) for group in groups])
        reach = np.array(
            [(m - np.min(g), np.max(g) - m) for m, g in zip(means, groups, strict=True)]
        )
        shift = spread * ((number + 0.5) / len(lines) - 0.5)
        panel.errorbar(
            present + shift,
            means,
            # Rounding may leave the mean of equal values beside them.
            yerr=np.maximum(reach.T, 0.0),
            color=_COLOURS[look % len(_COLOURS)],
            marker=_MARKERS[look % len(_MARKERS)],
            linestyle="none",
            elinewidth=0.9,
            label=label,
        )


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
