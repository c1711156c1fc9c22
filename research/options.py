"""Options that every investigation gets."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from armimp_common.errors import ConfigurationError


@dataclass(frozen=True, kw_only=True)
class InvestigationOptions:
    """Options of the command line; None for what was not given.

    Raises
    ------
    ConfigurationError
        If the seeds can't be understood, or there are fewer workers than one.
    """

    out: Path
    """New directory for the tables and figures."""
    seeds: str | None = None
    """As for :func:`armimp_bringup.study.parse_seeds`; None: those of the investigation,
    which say how many runs its numbers come from."""
    workers: int | None = None
    """Number of threads; None: one per core."""
    json: bool = False
    """Whether to print the result as JSON instead of a table."""
    only: str = ""
    """Pattern of the cases to run; empty: all."""

    def __post_init__(self) -> None:
        if self.seeds is not None:
            from armimp_bringup.study import parse_seeds

            parse_seeds(self.seeds)
        if self.workers is not None and self.workers < 1:
            raise ConfigurationError(f"--workers must be at least 1, got {self.workers}")
