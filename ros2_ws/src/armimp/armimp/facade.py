"""An interface for notebooks: recordings and results as plain arrays, and a few functions."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from numbers import Real
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from armimp_common.arrays import ComplexArray, FloatArray
from armimp_common.errors import ConfigurationError, DataError
from armimp_estimation.alignment.trial_windows import HIGHEST, LOWEST
from armimp_estimation.arm_models import ModelFit, require_model, supported
from armimp_estimation.fit import Calibration
from armimp_estimation.mbk import MBK
from armimp_estimation.metadata import Metadata
from armimp_estimation.problems import Problem, Severity
from armimp_estimation.record import TrialRecord


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """Trials of one experiment, in each of which one joint was perturbed."""

    trials: tuple[TrialRecord, ...]
    """Perturbation (N·m), position (rad) and torque on the arm (N·m), of shape (n, N)."""
    known: Metadata = field(default_factory=Metadata, repr=False)
    """What else is known: how torques were read, how well sensors are calibrated, and the arm that
    was simulated."""
    problems: tuple[Problem, ...] = ()
    """Problems of the trials that were found when they were read."""

    @property
    def truth(self) -> MBK | None:
        """The simulated arm; None if that is not known."""
        return self.known.truth

    @classmethod
    def from_arrays(  # noqa: PLR0913 (as many things are known of a recording)
        cls,
        perturbation: Sequence[ArrayLike] | ArrayLike,
        position: Sequence[ArrayLike] | ArrayLike,
        torque: Sequence[ArrayLike] | ArrayLike,
        *,
        rate: float,
        command: Sequence[ArrayLike] | ArrayLike | None = None,
        joint_names: Sequence[str] | None = None,
        timing: str = "unknown",
        torque_delay: float = 0.0,
        calibration: Calibration | None = None,
        robot_inertia: ArrayLike | None = None,
        robot_inertia_uncertainty: float = 0.05,
    ) -> Recording:
        """Make a recording of one array of shape (n, N) for each trial and signal.

        Parameters
        ----------
        perturbation : sequence of array_like
            Known perturbation of each joint, N·m, without feedback of the motion; the largest
            variance marks the perturbed joint. For a position servo its reference serves, as the
            scale doesn't matter.
        position : sequence of array_like
            Joint angles, rad.
        torque : sequence of array_like
            Torques applied to the arm, N·m.
        rate : float
            Samples per second, Hz. Arrays have no stamps, so every sample has to be there.
        command : sequence of array_like, optional
            Torque commands, N·m, each in force from its sample to the next.
        joint_names : sequence of str, optional
            Names of the n joints.
        timing : str
            When torques are read, relative to the command update at the same sample:
            ``before_update``, ``after_update``, ``mid_interval``, ``interval_mean`` or
            ``simultaneous``; ``unknown``: inferred from the records, with larger standard errors.
        torque_delay : float
            Delay of the torque readings beyond that instant, s.
        calibration : Calibration, optional
            Uncertainty of transducers and encoders; by default what is assumed of any: 1 % of gain
            and of cross-talk, 1.5 % of angles.
        robot_inertia : array_like, optional
            Inertia of the robot in the posture, kg·m², (n, n), with which commands less torques
            must agree: that checks signs, units and gains of all of them.
        robot_inertia_uncertainty : float
            Standard error of each of its elements, relative to those on the diagonal.

        Raises
        ------
        DataError
            If shapes disagree, a sample is not finite or not real, the perturbation of a trial is
            zero, the rate is not from 200 to 4000 Hz, there is no such timing, or the delay or the
            inertia is impossible.
        """
        declared: dict[str, Any] = {"torque_timing": timing, "torque_delay": float(torque_delay)}
        if robot_inertia is not None:
            try:
                declared["robot_inertia"] = _numbers(robot_inertia).ravel().tolist()
            except (TypeError, ValueError) as error:
                raise DataError(f"robot_inertia: {error}") from None
            declared["robot_inertia_uncertainty"] = float(robot_inertia_uncertainty)
        known = Metadata.of({name: json.dumps(value) for name, value in declared.items()})
        signals: list[Any] = [perturbation, position, torque]
        if command is not None:
            signals.append(command)
        try:
            listed = [[_numbers(trial) for trial in signal] for signal in signals]
        except (TypeError, ValueError) as error:
            raise DataError(f"signals are no arrays of numbers: {error}") from None
        counts = [len(signal) for signal in listed]
        if len(set(counts)) > 1:
            raise DataError(f"signals must have one array for each trial, but have {counts}")
        trials = list(zip(*listed, strict=True))
        if not trials or any(one.ndim != 2 for trial in trials for one in trial):
            raise DataError("each signal needs an array of shape (joints, samples) for each trial")
        for number, (pushed, *_) in enumerate(trials, start=1):
            if len(pushed) > pushed.shape[1]:
                raise DataError(
                    f"trial {number} has {len(pushed)} joints and {pushed.shape[1]} samples: "
                    "arrays must be of shape (joints, samples)"
                )
            if not pushed.any():
                raise DataError(f"trial {number}: the perturbation is zero throughout")
        if not (isinstance(rate, Real) and LOWEST <= rate <= HIGHEST):
            raise DataError(f"rate: {rate!r} is not from {LOWEST:g} to {HIGHEST:g} Hz")
        numbers = range(1, 1 + len(trials[0][0]))
        given = (f"joint_{i}" for i in numbers) if joint_names is None else joint_names
        names = tuple(map(str, given))
        records = [
            TrialRecord(
                trial=number,
                perturbed_joint=int(np.argmax(np.var(trial[0], axis=1))),
                rate=float(rate),
                joint_names=names,
                perturbation=trial[0],
                position=trial[1],
                torque=trial[2],
                command=None if command is None else trial[3],
                start_ns=0,
            )
            for number, trial in enumerate(trials, start=1)
        ]
        if calibration is not None:
            if not isinstance(calibration, Calibration):
                raise DataError(f"calibration must be a Calibration: {calibration!r:.60}")
            known = known.model_copy(update={"calibration": calibration})
        return cls(trials=tuple(records), known=known)


def _numbers(values: ArrayLike) -> FloatArray:
    """Return the values as floats; masked samples become NaN."""
    found: Any = np.ma.asarray(values)
    if np.iscomplexobj(found):
        raise ValueError("they are complex")
    return np.ma.filled(found.astype(np.float64), np.nan)


@dataclass(frozen=True, kw_only=True, eq=False)
class Result:
    """Inertia, viscosity and stiffness of the arm, with errors and a verdict."""

    joint_names: tuple[str, ...]
    """Names of the n joints."""
    M: FloatArray
    B: FloatArray
    K: FloatArray
    """In kg·m², N·m·s/rad and N·m/rad; shape (n, n)."""
    M_se: FloatArray
    B_se: FloatArray
    K_se: FloatArray
    """Their standard errors; shape (n, n)."""
    f: FloatArray = field(repr=False)
    """Frequencies, Hz; shape (n_freq,)."""
    Z: ComplexArray = field(repr=False)
    Z_variance: FloatArray = field(repr=False)
    """Impedance, N·m/rad, and the variance of each complex value; shape (n, n, n_freq)."""
    valid: bool
    """Whether M, B, K and their intervals can be trusted."""
    impedance_valid: bool
    """Whether Z(f) and its variance can be trusted."""
    problems: tuple[str, ...]
    """Why the result, or what of it, is not valid."""
    notes: tuple[str, ...]
    """What was found and corrected, or is in the standard errors."""
    models: dict[str, ModelFit] = field(default_factory=dict, repr=False)
    """Models of the arm that were fitted in addition to M, B and K, with values and errors."""
    model: str | None = None
    """Name of the best model that fits and was requested or is resolved; None if there is none."""

    def interval(
        self, matrix: Literal["M", "B", "K"], level: float = 0.95
    ) -> tuple[FloatArray, FloatArray]:
        """Return the confidence interval of each element, from a normal distribution.

        Parameters
        ----------
        matrix : {"M", "B", "K"}
        level : float
            Probability with which the interval contains the true value.

        Returns
        -------
        low, high : ndarray, shape (n, n)
        """
        from scipy.special import ndtri

        level_known = isinstance(level, Real) and 0.0 < level < 1.0
        if matrix not in ("M", "B", "K") or not level_known:
            raise ConfigurationError(f"there is no interval of {matrix!r} at level {level!r}")
        value = getattr(self, matrix)
        half = ndtri(0.5 * (1.0 + level)) * getattr(self, f"{matrix}_se")
        return value - half, value + half


def simulate(**options: Any) -> Recording:
    """Simulate an experiment; samples are those of ``armimp run`` with the same options.

    Parameters
    ----------
    **options
        As for ``armimp run``, such as ``joints``, ``friction``, ``resolution``, ``perturbation``,
        ``duration`` (s) or ``seed``.

    Raises
    ------
    ConfigurationError
        If there is no such option, or its value is out of range.
    """
    from armimp_bringup.config import load_config
    from armimp_bringup.offline import simulate as run_without_ros

    config = load_config(None, options)
    (experiment,) = run_without_ros([config])
    return Recording(trials=experiment.records, known=experiment.known)


def read_bag(*bags: str | Path, rate: float | None = None) -> Recording:
    """Read the trials of bags that belong to one experiment.

    Parameters
    ----------
    *bags : str or Path
        rosbag2 directories, ``.mcap`` or ``.db3`` files, or the directory of a run.
    rate : float, optional
        Sampling rate, Hz, with which the stamps must agree; needed only if it is unusual.

    Raises
    ------
    BagError
        If a bag can't be read.
    DataError
        If the bags don't belong together, or a trial has lost samples or clipped commands.
    """
    from armimp_bringup.offline_estimate import read_bags
    from armimp_estimation.result import problems_of

    if not bags:
        raise DataError("no bag is given")
    contents, metadata = read_bags([Path(bag) for bag in bags])
    trials = [trial for content in contents for trial in content.trials]
    records = []
    for trial in trials:
        record, *others = trial.intact()
        if others:
            raise DataError(f"trial {record.trial}: clipped commands divide it: armimp estimate")
        records.append(record)
    if rate is not None:
        metadata["sampling_rate"] = json.dumps(float(rate))
    known = Metadata.of(metadata)
    return Recording(
        trials=tuple(records),
        known=known,
        problems=tuple(problems_of(trials, known)),
    )


def identify(recording: Recording, estimator: str = "lpm_full", model: str | None = None) -> Result:
    """Identify M, B and K from one trial for each joint.

    Parameters
    ----------
    recording : Recording
    estimator : str
        Name of an estimator, such as ``lpm_full`` or ``welch_siso``.
    model : str, optional
        Model of the arm to fit beside M, B and K: ``mbk_delay``, ``reflex``, ``cuff``; ``mbk`` for
        none; ``auto`` for all where M, B and K don't fit. By default as recorded, else ``auto``.

    Raises
    ------
    ConfigurationError
        If there is no such estimator or model.
    DataError
        If the trials cannot be estimated.
    """
    from armimp_estimation.identify import identify_records

    if not isinstance(recording, Recording):
        raise DataError(f"identify takes a Recording, not {type(recording).__name__}")
    if not isinstance(estimator, str):
        raise ConfigurationError(f"estimator: {estimator!r} is no name of one")
    if not recording.trials:
        raise DataError("there is no trial in the recording")
    known = recording.known
    if model is not None:
        known = known.model_copy(update={"arm_model": require_model(model)})
    found = identify_records([[one] for one in recording.trials], [estimator], known)
    found = replace(found, problems=(*recording.problems, *found.problems))
    one = found.estimators[estimator]
    sentences = {
        severity: tuple(each.sentence for each in found.problems if each.severity is severity)
        for severity in Severity
    }
    return Result(
        joint_names=found.joint_names,
        M=one.fit.mbk.M,
        B=one.fit.mbk.B,
        K=one.fit.mbk.K,
        M_se=one.fit.errors[0],
        B_se=one.fit.errors[1],
        K_se=one.fit.errors[2],
        f=one.estimate.f,
        Z=one.estimate.Z,
        Z_variance=one.estimate.variance,
        valid=found.valid,
        impedance_valid=found.verdict.impedance,
        problems=sentences[Severity.ERROR],
        notes=sentences[Severity.NOTE],
        models=one.models,
        model=supported(one.models),
    )
