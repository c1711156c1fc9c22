"""From assembled trials to the result that is shown and stored; live and offline use this path."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from armimp_common.contract import PERTURBATION
from armimp_common.errors import ArmimpError, DataError
from armimp_estimation.assemble import AssembledTrial
from armimp_estimation.identify import Identification, identify
from armimp_estimation.mbk import MBK
from armimp_estimation.results import (
    Summary,
    TrialLedger,
    TrialSummary,
    TruthSummary,
    summarise,
    write_frf,
    write_summary,
)
from armimp_estimation.settings import IdentifyConfig
from armimp_estimation.spectra import WelchConfig
from armimp_estimation.trial import TrialData

SUMMARY_FILE = "summary.json"
FRF_FILE = "frf.npz"


@dataclass(frozen=True, kw_only=True, eq=False)
class FinishedTrial:
    """A trial as it came out of the recorder or of a bag.

    Parameters
    ----------
    assembled : AssembledTrial
        Samples and their ledger.
    bag : str or None
        Where it is stored.
    rtf : float
        Times real time at which it ran; NaN if it was not run live.
    """

    assembled: AssembledTrial
    bag: str | None
    rtf: float = math.nan


@dataclass(frozen=True, kw_only=True, eq=False)
class Conclusion:
    """Result of an experiment.

    Attributes
    ----------
    summary : Summary
        Content of ``summary.json``; says whether the result is valid, and why not.
    identification : Identification or None
        Curves and scores; None if nothing could be estimated.
    """

    summary: Summary
    identification: Identification | None

    def write(self, directory: Path) -> None:
        """Write ``summary.json`` and, if there are curves, ``frf.npz``.

        Raises
        ------
        DataError
            If a file exists already or cannot be written.
        """
        if self.identification is not None:
            write_frf(
                directory / FRF_FILE,
                {name: r.estimate for name, r in self.identification.estimators.items()},
            )
        write_summary(directory / SUMMARY_FILE, self.summary)


def conclude(
    trials: Sequence[FinishedTrial],
    *,
    metadata: Mapping[str, str],
    joints: int,
    estimators: Sequence[str],
    config: IdentifyConfig | None = None,
    problems: Sequence[str] = (),
) -> Conclusion:
    """Identify the impedance from the trials; what stands against it becomes a problem.

    Parameters
    ----------
    trials : sequence of FinishedTrial
        One for each joint.
    metadata : mapping of str to str
        That of the bags: configuration, seed and, from a simulator, the truth.
    joints : int
        Number of joints n.
    estimators : sequence of str
        Names of estimators.
    config : IdentifyConfig, optional
        Options; by default Welch segments that suit the shortest trial.
    problems : sequence of str
        What is known to have gone wrong beforehand.

    Raises
    ------
    ConfigurationError
        If an estimator does not exist.
    """
    found = list(problems)
    identification = None
    truth = truth_of(metadata)
    try:
        records = [trial.assembled.require() for trial in trials]
        if config is None:
            shortest = min((record.samples for record in records), default=0)
            config = IdentifyConfig(welch=WelchConfig.for_samples(shortest))
        data = [TrialData.from_record(record, config.welch) for record in records]
        identification = identify(data, estimators, truth, config)
    except DataError as error:
        found.append(str(error))
    seed = _seed_of(trials, metadata)
    if identification is None:
        return Conclusion(
            summary=Summary(
                config=_parsed(metadata, "config", {}),
                joints=joints,
                seed=seed,
                valid=False,
                problems=found,
                trials=[_bare(trial, joints) for trial in trials],
                estimators={},
                truth=None if truth is None else TruthSummary.of(truth),
            ),
            identification=None,
        )
    ledgers = {trial.assembled.require().perturbed_joint: _ledger(trial) for trial in trials}
    summary = summarise(
        identification,
        ledgers,
        config=_parsed(metadata, "config", {}),
        seed=seed,
        problems=tuple(found),
    )
    return Conclusion(summary=summary, identification=identification)


def truth_of(metadata: Mapping[str, str]) -> MBK | None:
    """True matrices from the metadata of a bag; None if it does not know them.

    Raises
    ------
    DataError
        If they are there, but make no sense.
    """
    truth = _parsed(metadata, "truth", None)
    if truth is None:
        return None
    try:
        return MBK(**{name: np.array(truth[name], dtype=np.float64) for name in ("M", "B", "K")})
    except (KeyError, TypeError, ValueError, ArmimpError) as error:
        raise DataError(f"metadata: truth is not three matrices M, B, K: {error}") from None


def _parsed(metadata: Mapping[str, str], key: str, default: Any) -> Any:
    if key not in metadata:
        return default
    try:
        return json.loads(metadata[key])
    except ValueError:
        raise DataError(f"metadata: {key} is not JSON: {metadata[key][:60]!r}") from None


def _seed_of(trials: Sequence[FinishedTrial], metadata: Mapping[str, str]) -> int | None:
    seed = _parsed(metadata, "seed", None)
    if isinstance(seed, int):
        return seed
    return trials[0].assembled.window.seed if trials else None


def _ledger(trial: FinishedTrial) -> TrialLedger:
    ledger = trial.assembled.ledger
    return TrialLedger(
        bag=trial.bag,
        ticks=ledger.streams[PERTURBATION].received,
        lost=ledger.lost,
        rtf=trial.rtf,
    )


def _bare(trial: FinishedTrial, joints: int) -> TrialSummary:
    """A trial without scores, as nothing could be estimated."""
    ledger = _ledger(trial)
    return TrialSummary(
        k=trial.assembled.window.joint + 1,
        bag=ledger.bag,
        ticks=ledger.ticks,
        lost=ledger.lost,
        lock_ratio=[math.nan] * joints,
        bias_bound=[math.nan] * joints,
        rtf=ledger.rtf,
    )
