"""What to do with trials that lost samples, or of which some must not be used."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from armimp_common.errors import ConfigurationError
from armimp_estimation.alignment.assemble import AssembledTrial
from armimp_estimation.record import TrialRecord
from armimp_estimation.spectra import WelchConfig


@dataclass(frozen=True, kw_only=True)
class GapConfig:
    """Options for trials with gaps.

    Parameters
    ----------
    allow : bool
        Estimate from the intact parts of trials that lost samples or were aborted; else such
        trials are refused. The result of one that was aborted is not valid.
        Intervals in which the controller clipped its command are left out in any case.
    most_excluded : float
        Largest share of the samples of a trial that may be left out, from 0 to 1. Beyond, there
        is an estimate, but the result is not valid.
    """

    allow: bool = False
    most_excluded: float = 0.05

    def __post_init__(self) -> None:
        if not 0.0 <= self.most_excluded <= 1.0:
            raise ConfigurationError(
                f"most_excluded must lie between 0 and 1, got {self.most_excluded!r}"
            )


def judge_gaps(trial: AssembledTrial, config: GapConfig) -> list[str]:
    """Problems with a trial that was estimated from its intact parts, in words."""
    ledger = trial.ledger
    problems = [f"trial {trial.trial}: {trial.window.fault}"] if trial.window.aborted else []
    if not ledger.excluded_share <= config.most_excluded:
        problems.append(
            f"trial {trial.trial}: {100 * ledger.excluded_share:.3g} % of its samples are "
            f"excluded (limit {100 * config.most_excluded:.3g} %)"
        )
    if ledger.clipped and not trial.window.clipped_intervals:
        problems.append(
            f"trial {trial.trial}: {ledger.clipped} commands were clipped, and it is not known when"
        )
    return problems


def segments_for(trials: Sequence[Sequence[TrialRecord]]) -> WelchConfig:
    """Welch segments that suit the intact parts of the trial that has the least of them."""
    configs = [
        WelchConfig.for_stretches([part.samples for part in parts], parts[0].rate)
        for parts in trials
    ]
    return min(configs, key=lambda config: config.segment, default=WelchConfig.for_samples(0))
