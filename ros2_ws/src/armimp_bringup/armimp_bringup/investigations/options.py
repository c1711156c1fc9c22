"""What every investigation is told."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, kw_only=True)
class InvestigationOptions:
    """Options of the command line; None for what was not given.

    Parameters
    ----------
    out : new directory for the tables and figures
    seeds : as for :func:`armimp_bringup.study.conditions.parse_seeds`; None: those of the
        investigation, which say how many runs its numbers come from
    workers : number of threads; None: one per core
    json : whether to print the result as JSON instead of a table
    """

    out: Path
    seeds: str | None = None
    workers: int | None = None
    json: bool = False
