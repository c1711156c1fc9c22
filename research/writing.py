"""Output of all investigations: JSON, CSV, figures, and a table on the terminal."""

from __future__ import annotations

import csv
import functools
import io
import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.measure import Measurement
from rich.table import Table

from armimp_bringup.terminal import display
from armimp_estimation.atomic_write import write_atomically, write_text
from research.options import InvestigationOptions

# Colours by Okabe and Ito, which colour-blind readers can tell apart.
COLOURS: Final = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
MARKERS: Final = ("o", "s", "^", "D", "v", "P", "X")
WIDTH: Final = 7.16  # inches, two columns of a journal
_DPI: Final = 150
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
    "lines.linewidth": 1.0,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "grid.linewidth": 0.4,
    "pdf.fonttype": 42,  # embedded as TrueType, as journals ask for
}


def present(
    options: InvestigationOptions,
    name: str,
    result: Mapping[str, Any],
    rows: Sequence[Mapping[str, Any]],
    figures: Callable[[], Mapping[str, Any]],
) -> bool:
    """Write tables and figures of an investigation, and print its JSON if that is requested.

    Parameters
    ----------
    options : where to, and whether to print JSON
    name, result, rows : as for :func:`write_tables`
    figures : draws the figures, by name of their files

    Returns
    -------
    bool
        Whether words and tables are to be printed instead.

    Raises
    ------
    DataError
        If a file can't be written.
    """
    import matplotlib as mpl

    write_tables(options.out, name, result, rows)
    display().phase("drawing")
    with mpl.rc_context(_STYLE):
        for file, figure in figures().items():
            write_figure(options.out, file, figure)
    display().close()
    if options.json:
        print(to_json(result))
    return not options.json


def write_figure(directory: Path, name: str, figure: Any) -> list[Path]:
    """Write a figure as PNG and PDF.

    Parameters
    ----------
    directory : Path
    name : without suffix
    figure : matplotlib.figure.Figure

    Raises
    ------
    DataError
        If a file can't be written.
    """
    paths = []
    # A creation date would make every file differ from the one before.
    for suffix, metadata in (("png", None), ("pdf", {"CreationDate": None})):
        path = directory / f"{name}.{suffix}"
        save = functools.partial(figure.savefig, dpi=_DPI, metadata=metadata)
        write_atomically(path, save, anew=True)
        paths.append(path)
    return paths


def to_json(result: Mapping[str, Any]) -> str:
    """Return JSON with null for numbers that are not finite, which JSON cannot express."""
    return json.dumps(_finite(result), indent=1, allow_nan=False)


def write_tables(
    directory: Path, name: str, result: Mapping[str, Any], rows: Sequence[Mapping[str, Any]]
) -> None:
    """Write NAME.json, and NAME.csv with one line for each row.

    Parameters
    ----------
    directory : Path
    name : of the investigation
    result : content of the JSON file
    rows : all with the keys of the first one, at least one

    Raises
    ------
    DataError
        If a file can't be written.
    """
    write_text(directory / f"{name}.json", to_json(result) + "\n")
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(_finite(row) for row in rows)
    write_text(directory / f"{name}.csv", text.getvalue())


def print_table(
    title: str,
    columns: Sequence[str],
    rows: Sequence[Sequence[str]],
    caption: str | None = None,
    console: Console | None = None,
) -> None:
    """Print a table; the first column is text, the others are numbers."""
    out = console if console is not None else Console()
    table = Table(
        title=title,
        caption=caption,
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        title_justify="left",
        caption_justify="left",
    )
    for number, column in enumerate(columns):
        table.add_column(column, justify="right" if number else "left", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    # Rather wider than the terminal than truncated.
    wide = Measurement.get(out, out.options.update(max_width=1000), table).maximum
    out.width = max(out.width, wide)
    out.print(table)


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _finite(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(one) for one in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
