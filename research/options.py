"""What every investigation is told."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from armimp_common.errors import ConfigurationError


@dataclass(frozen=True, kw_only=True)
class InvestigationOptions:
    """Options of the command line; None for what was not given.

    Parameters
    ----------
    out : new directory for the tables and figures
    seeds : as for :func:`armimp_bringup.study.conditions.parse_seeds`; None: those of the
        investigation, which say how many runs its numbers come from
    workers : number of threads; None: one per core
    only : pattern of the cases to run; empty: all
    json : whether to print the result as JSON instead of a table

    Raises
    ------
    ConfigurationError
        If the seeds can't be understood, or there are fewer workers than one.
    """

    out: Path
    seeds: str | None = None
    workers: int | None = None
    json: bool = False
    only: str = ""

    def __post_init__(self) -> None:
        if self.seeds is not None:
            from armimp_bringup.study.conditions import parse_seeds

            parse_seeds(self.seeds)
        if self.workers is not None and self.workers < 1:
            raise ConfigurationError(f"--workers must be at least 1, got {self.workers}")
