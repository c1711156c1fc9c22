"""Arm models with terms in addition to M, B and K, fitted to the same impedance.

Each :class:`ArmModel` is an equation ``Z(s)`` with the matrices M, B and K of the arm itself and a
few further parameters. All are fitted by weighted complex least squares with the weights of the
M-B-K fit, and judged alike: by lack of fit, by lack of fit at bins that were held out (cross-
validation), and by an information criterion. See section 9 of the theory page.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from armimp_common.arrays import BoolArray, ComplexArray, FloatArray
from armimp_common.errors import ConfigurationError, DataError
from armimp_estimation.estimators.estimate import ImpedanceEstimate
from armimp_estimation.fit import Calibration, MBKFit
from armimp_estimation.json_model import JsonModel, Matrix, Number, Vector
from armimp_estimation.mbk import UNITS
from armimp_estimation.weighted_fit import lack_of_fit, lack_ratio
from armimp_estimation.weights import covariance_of_sums, fit_weights, root_of

Values = Mapping[str, FloatArray]

AUTO: Final = "auto"
MBK_MODEL: Final = "mbk"
DIAGONAL: Final = "diagonal"
KEPT: Final = "kept"
_MOST_JOINTS = 4  # number of joints up to which models are looked for
_BLOCK = 0.5  # width of the stretches of bins that are held out in turn, Hz
_STRONG = 10.0
"""Difference of the criterion that is strong evidence (Kass & Raftery, J. Am. Stat. Ass. 1995)."""
_CLEARLY = 2.0
"""Number of standard errors from 0 beyond which a parameter is resolved."""
_ITERATIONS = 30  # evaluations of a least-squares fit per free parameter, at most
_FAR = 40.0  # largest absolute logarithm of a positive parameter, so that none overflows
_LEAST = 1e-6  # size of a parameter, and of its effect in weighted residuals, that counts as none


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One parameter of a model: a matrix, a value for each joint, or one value.

    Attributes
    ----------
    name, unit : str
    rank : int
        2 for a matrix (n, n), 1 for a value for each joint, 0 for one value.
    positive : bool
        Whether it must be above 0.
    """

    name: str
    unit: str
    rank: int = 2
    positive: bool = False


INTRINSIC: Final = tuple(Parameter(name=name, unit=unit) for name, unit in UNITS.items())


@dataclass(frozen=True, kw_only=True)
class ArmModel:
    """Description of a model."""

    equation: str
    """``Z(s)`` in terms of the names of its parameters."""
    parameters: tuple[Parameter, ...]
    """M, B and K first."""
    impedance: Callable[[Values, ComplexArray], ComplexArray]
    """Function of values by name and ``s = jω``, (n_freq,), that returns Z, (n, n, n_freq)."""
    starts: tuple[Mapping[str, float], ...]
    """Sets of initial values, each of which is tried. Other parameters start at 0, and M, B and K
    from their plain fit."""
    variants: tuple[Mapping[str, str], ...] = ({},)
    """From simple to full: parameters of which only the diagonal is free, or which keep their
    initial values. A fuller variant has to improve the criterion by more than `_STRONG`."""
    possible: Callable[[Values], bool] = lambda _: True
    """Whether an arm can have these values; solutions that are possible take precedence."""


class ParameterFit(JsonModel):
    """One parameter: numbers row by row, as many as a matrix, the joints, or one; SI units."""

    values: Vector
    """Fitted values."""
    errors: Vector
    """Standard errors; null for values that have no effect, or were not fitted."""
    unit: str
    """SI unit of both."""


class ModelFit(JsonModel):
    """A model of the arm beside M, B and K, see `armimp_estimation.arm_models`."""

    equation: str
    """Z(s) in its parameters."""
    parameters: dict[str, ParameterFit]
    """By name, M, B and K first, see below."""
    lack_of_fit: Matrix
    """Misfit of the model relative to that which noise explains."""
    held_out: Number
    """Mean lack of fit of bins that were held out of the fit; null if the model doesn't fit."""
    criterion: Number
    """Bayesian information criterion, less is better."""
    fits: bool
    """Whether an arm can be so, and noise explains the residual, both in the fit and held out."""
    declared: bool = False
    """Whether the model was asked for by its name, not searched for."""

    @property
    def elements(self) -> Iterator[tuple[str, tuple[int, ...], float, float, str]]:
        """Name, indices from 1, value, standard error and unit of each number."""
        n = len(self.lack_of_fit)
        shapes = {n * n: (n, n), n: (n,), 1: ()}
        for name, one in self.parameters.items():
            places = np.ndindex(shapes.get(len(one.values), (len(one.values),)))
            for place, value, error in zip(places, one.values, one.errors, strict=False):
                yield name, tuple(index + 1 for index in place), value, error, one.unit

    @property
    def beside(self) -> dict[str, ParameterFit]:
        """Parameters other than M, B and K, by name."""
        return dict([*self.parameters.items()][len(INTRINSIC) :])

    @property
    def resolved(self) -> bool:
        """Whether any parameter other than M, B and K differs significantly from 0."""
        pairs = (zip(one.values, one.errors, strict=True) for one in self.beside.values())
        return any(abs(value) > _CLEARLY * error for pair in pairs for value, error in pair)

    @property
    def text(self) -> str:
        """Values and standard errors of the parameters other than M, B and K, as text."""
        parts = []
        for name, one in self.beside.items():
            pairs = zip(one.values, one.errors, strict=True)
            fitted = [f"{value:.4g} ± {error:.2g}" for value, error in pairs if error >= 0.0]
            if fitted:
                parts.append(f"{name} {', '.join(fitted)} {one.unit}".rstrip())
        return "; ".join(parts)


def _intrinsic(values: Values, s: ComplexArray) -> ComplexArray:
    M, B, K = (values[one.name][:, :, None] for one in INTRINSIC)
    return np.asarray(M * s**2 + B * s + K, dtype=np.complex128)


def _delayed(values: Values, s: ComplexArray) -> ComplexArray:
    return np.asarray(_intrinsic(values, s) * np.exp(-s * values["delay"]))


def _reflex(values: Values, s: ComplexArray) -> ComplexArray:
    omega, zeta = values["muscle"], values["damping_ratio"]
    arc = np.exp(-s * values["delay"]) * omega**2 / (s**2 + 2.0 * zeta * omega * s + omega**2)
    gains = values["velocity_gain"][:, :, None] * s + values["stretch_gain"][:, :, None]
    return np.asarray(_intrinsic(values, s) + arc * gains)


def _resists(values: Values) -> bool:
    """Whether a stretch reflex resists the stretch."""
    return bool((np.diag(values["velocity_gain"]) >= 0.0).all())


def _cuffed(values: Values, s: ComplexArray) -> ComplexArray:
    arm = np.moveaxis(_intrinsic(values, s), 2, 0)
    cuff = values["cuff_stiffness"] + values["cuff_damping"] * s[:, None]
    both = arm + cuff[:, :, None] * np.eye(arm.shape[1])
    series = cuff[:, :, None] * np.linalg.solve(both, arm)
    return np.ascontiguousarray(np.moveaxis(series, 0, 2))


_DELAY = Parameter(name="delay", unit="s", rank=0)
_LATENESS = Parameter(name="torque_delay", unit="s", rank=0)
"""Common delay of torque readings; unless known exactly, fitted in models without `_DELAY`."""

MODELS: Final[Mapping[str, ArmModel]] = {
    "mbk_delay": ArmModel(
        equation="(M s² + B s + K) exp(-s delay)",
        parameters=(*INTRINSIC, _DELAY),
        impedance=_delayed,
        starts=({"delay": 0.0}, {"delay": 0.01}),
    ),
    "reflex": ArmModel(
        equation=(
            "M s² + B s + K + exp(-s delay) muscle² / (s² + 2 damping_ratio muscle s + "
            "muscle²) (velocity_gain s + stretch_gain)"
        ),
        parameters=(
            *INTRINSIC,
            Parameter(name="velocity_gain", unit="N·m·s/rad"),
            Parameter(name="stretch_gain", unit="N·m/rad"),
            Parameter(name="delay", unit="s", rank=0, positive=True),
            Parameter(name="muscle", unit="rad/s", rank=0, positive=True),
            Parameter(name="damping_ratio", unit="", rank=0, positive=True),
        ),
        impedance=_reflex,
        starts=tuple(
            {"delay": delay, "muscle": muscle, "damping_ratio": 1.0}
            for delay in (0.025, 0.045, 0.07)
            for muscle in (10.0, 25.0, 60.0)
        ),
        variants=(
            {"velocity_gain": DIAGONAL, "stretch_gain": KEPT, "damping_ratio": KEPT},
            {"velocity_gain": DIAGONAL, "stretch_gain": DIAGONAL, "damping_ratio": KEPT},
            {"velocity_gain": DIAGONAL, "stretch_gain": DIAGONAL},
            {},
        ),
        possible=_resists,
    ),
    "cuff": ArmModel(
        equation="((M s² + B s + K)⁻¹ + (cuff_stiffness + cuff_damping s)⁻¹)⁻¹",
        parameters=(
            *INTRINSIC,
            Parameter(name="cuff_stiffness", unit="N·m/rad", rank=1, positive=True),
            Parameter(name="cuff_damping", unit="N·m·s/rad", rank=1, positive=True),
        ),
        impedance=_cuffed,
        starts=tuple(
            {"cuff_stiffness": stiffness, "cuff_damping": 0.001 * stiffness}
            for stiffness in (1e3, 1e4, 1e5)
        ),
    ),
}
"""Models by name, without plain ``mbk``."""


def require_model(name: str) -> str:
    """Return a name if it is that of a model, ``auto`` or ``mbk``.

    Raises
    ------
    ConfigurationError
        If it is not.
    """
    known = (AUTO, MBK_MODEL, *MODELS)
    if name not in known:
        raise ConfigurationError(f"unknown model {name!r}, known are {', '.join(known)}")
    return name


def fit_models(
    asked: str,
    estimate: ImpedanceEstimate,
    plain: MBKFit,
    calibration: Calibration,
) -> dict[str, ModelFit]:
    """Fit the model that is asked for, or all if M, B and K don't fit an unbiased estimate.

    Parameters
    ----------
    asked : str
        Name of a model, ``auto`` or ``mbk``.
    estimate : ImpedanceEstimate
        As the estimator returns it: a delay that it leaves open is fitted in each model anew.
    plain : MBKFit
        Fit of M, B and K to that estimate.
    calibration : Calibration
        Errors of transducers and encoders.

    Returns
    -------
    dict of str to ModelFit
        By name of the model; without those that have more parameters than the data.

    Raises
    ------
    DataError
        If that is so of the model that is asked for.
    """
    if asked == MBK_MODEL:
        return {}
    names: Sequence[str] = (asked,)
    if asked == AUTO:
        tried = not plain.of_form and estimate.unbiased and estimate.joints <= _MOST_JOINTS
        names = [*MODELS] if tried else ()
    problems = {name: _Problem(MODELS[name], estimate, plain, calibration) for name in names}
    if asked != AUTO and not problems[asked].determined:
        raise DataError(f"{estimate.f.size} frequencies are too few to fit the model {asked}")
    return {
        name: one.fit(declared=asked != AUTO) for name, one in problems.items() if one.determined
    }


def supported(models: Mapping[str, ModelFit]) -> str | None:
    """Return the name of the model to report: of those that fit, the one of best criterion.

    A model that was not asked for by name must be resolved, too. None if there is no such model.
    """
    possible = (n for n, one in models.items() if one.fits and (one.declared or one.resolved))
    return min(possible, key=lambda name: models[name].criterion, default=None)


class _Problem:
    """Least-squares problem of one model and one impedance."""

    def __init__(
        self,
        model: ArmModel,
        estimate: ImpedanceEstimate,
        plain: MBKFit,
        calibration: Calibration,
    ) -> None:
        n = estimate.joints
        floor = estimate.weight_floor
        self.calibration = calibration
        self.model, self.estimate, self.plain = model, estimate, plain
        self.s: ComplexArray = np.asarray(2j * np.pi * estimate.f, dtype=np.complex128)
        self.doubt = 0.0 if _DELAY in model.parameters else estimate.delay_uncertainty or 0.0
        self.parameters = (*model.parameters, *([_LATENESS] if self.doubt else []))
        self.shapes = [(n,) * one.rank for one in self.parameters]
        self.ends = np.cumsum([math.prod(shape) for shape in self.shapes])
        Z, variance, power = estimate.Z, estimate.variance, estimate.power
        self.weights = fit_weights(estimate.f, Z, variance, floor, power)
        # Weights have a maximum of 1 in each element; rows differ in noise, so they are scaled.
        least = np.min(estimate.variance + (floor * np.abs(estimate.Z)) ** 2, axis=2)
        self.weights /= least[:, :, None]
        # Neighbouring bins share most of their information.
        self.used = np.arange(self.s.size) % max(1, len(estimate.bin_correlation) // 4) == 0
        self.weights *= self.used
        self.positive: BoolArray = self.vector(lambda one: one.positive)

    @property
    def determined(self) -> bool:
        """Whether there are more data, as real numbers, than parameters."""
        return 2 * self.estimate.joints**2 * int(np.sum(self.used)) > self.positive.size

    def vector(self, of: Callable[[Parameter], Any]) -> NDArray[Any]:
        """Stack a property of each parameter, one value or an array of its shape, to (p,)."""
        pairs = zip(self.parameters, self.shapes, strict=True)
        return np.concatenate([np.ravel(np.broadcast_to(of(one), shape)) for one, shape in pairs])

    def values(self, vector: FloatArray) -> dict[str, FloatArray]:
        parts = np.split(vector, self.ends[:-1])
        return {
            one.name: part.reshape(shape)
            for one, part, shape in zip(self.parameters, parts, self.shapes, strict=True)
        }

    def impedance(self, vector: FloatArray, bins: BoolArray | slice = slice(None)) -> ComplexArray:
        values, s = self.values(vector), self.s[bins]
        late = np.exp(-s * values.get(_LATENESS.name, np.zeros(())))
        return np.asarray(self.model.impedance(values, s) * late)

    def start(self, given: Mapping[str, float]) -> FloatArray:
        mbk = self.plain.mbk
        return self.vector(
            lambda one: getattr(mbk, one.name) if one in INTRINSIC else given.get(one.name, 0.0)
        )

    def free(self, variant: Mapping[str, str]) -> BoolArray:
        """Which elements of the parameters are free in a variant, (p,)."""
        kinds = {None: True, KEPT: False, DIAGONAL: np.eye(self.estimate.joints) > 0.0}
        return self.vector(lambda one: kinds[variant.get(one.name)])

    def solve(
        self,
        start: FloatArray,
        free: BoolArray,
        bins: BoolArray,
        tolerance: float = 1e-6,
    ) -> tuple[FloatArray, float]:
        """Fit free parameters to some bins; return all parameters and half the sum of squares."""
        from scipy.optimize import least_squares

        root = np.sqrt(self.weights[:, :, bins])
        measured = self.estimate.Z[:, :, bins]
        positive = self.positive[free]

        def whole(vector: FloatArray) -> FloatArray:
            solution: FloatArray = start.copy()
            solution[free] = np.where(positive, np.exp(np.clip(vector, -_FAR, _FAR)), vector)
            return solution

        def residual(vector: FloatArray) -> FloatArray:
            solution = whole(vector)
            left = root * (self.impedance(solution, bins) - measured)
            prior = [solution[-1] / self.doubt] if self.doubt else []
            return np.concatenate((left.real.ravel(), left.imag.ravel(), prior))

        # Positive parameters are fitted as logarithms, so none of them needs a bound.
        first = np.where(positive, np.log(np.where(positive, start[free], 1.0)), start[free])
        most = _ITERATIONS * (first.size + 1)
        found = least_squares(
            residual, first, method="lm", x_scale="jac", ftol=tolerance, max_nfev=most
        )
        return whole(found.x), float(found.cost)

    def fit(self, *, declared: bool) -> ModelFit:
        """Fit each variant; take a fuller one only if its criterion is clearly better."""
        # With fixed scalars, most models are linear.
        free = self.free(self.model.variants[0])
        rough = free & self.vector(lambda one: one.rank == 2)
        starts = [self.solve(self.start(one), rough, self.used, 1e-2) for one in self.model.starts]
        found = [self.solve(one, free, self.used) for one, _ in starts]
        possible = [one for one in found if self.model.possible(self.values(one[0]))]
        solution = min(possible or found, key=lambda one: one[1])[0]
        criterion, trial = math.inf, solution
        for variant in self.model.variants:
            more = self.free(variant)
            trial = self.solve(trial, more, self.used)[0]
            value = self.criterion(trial, more)
            possible_too = self.model.possible(self.values(trial)) or criterion == math.inf
            if value < criterion - _STRONG and possible_too:
                criterion, solution, free = value, trial, more
        fitted = self.impedance(solution)
        lack = lack_of_fit(self.estimate, fitted)
        limit = self.plain.lack_limit
        fits = bool((lack <= limit).all())
        held_out = self.held_out(solution, free) if fits else math.nan
        values = self.values(solution)
        errors = self.values(self.errors(solution, free))
        return ModelFit(
            equation=self.model.equation,
            parameters={
                one.name: ParameterFit(
                    values=values[one.name].ravel().tolist(),
                    errors=errors[one.name].ravel().tolist(),
                    unit=one.unit,
                )
                for one in self.model.parameters
            },
            lack_of_fit=lack.tolist(),
            held_out=held_out,
            criterion=criterion,
            fits=fits and held_out <= limit and self.model.possible(values),
            declared=declared,
        )

    def held_out(self, solution: FloatArray, free: BoolArray) -> float:
        """Mean lack of fit at every other stretch of bins, with the model fitted to the others."""
        even = np.floor(self.estimate.f / _BLOCK).astype(int) % 2 == 0
        left = []
        for bins in (even, ~even):
            few = np.sum(bins & self.used) * self.estimate.joints**2 <= np.sum(free)
            if few or bins.all():
                return math.nan
            other = self.solve(solution, free, bins & self.used)[0]
            ratio = lack_ratio(self.estimate, self.impedance(other))
            left.append(np.mean(ratio[:, :, ~bins]))
        return float(np.mean(left))

    def criterion(self, solution: FloatArray, free: BoolArray) -> float:
        """Bayesian criterion ``χ² + p log N`` with N independent real numbers; less is better."""
        ratio = lack_ratio(self.estimate, self.impedance(solution))
        rho = np.mean(self.estimate.bin_correlation, axis=1)
        independent = 2.0 * ratio.size / (1.0 + 2.0 * float(np.sum(np.abs(rho[1:]))))
        return independent * float(np.mean(ratio)) + np.sum(free) * math.log(independent)

    def errors(self, solution: FloatArray, free: BoolArray) -> FloatArray:
        """Standard errors of the parameters, (p,), by the sandwich formula, for any weights.

        To first order ``δp = Re Σ conj(b) δZ`` over elements and bins, with ``b = N⁻¹ W ∂Z/∂p``.
        """
        n, bins = self.estimate.joints, self.s.size
        slopes = np.stack([*self._slopes(solution)])
        flat = slopes.reshape(solution.size, -1)
        weighted = self.weights.reshape(-1) * flat
        size = np.linalg.norm(np.sqrt(self.weights.reshape(-1)) * flat, axis=1)
        # A parameter that went to 0 or to infinity has no effect any more.
        free = free & (size * np.maximum(np.abs(solution), _LEAST) > _LEAST)
        normal = (np.conj(flat[free]) @ weighted[free].T).real
        if self.doubt and free[-1]:
            normal[-1, -1] += 1.0 / self.doubt**2
        scale = np.sqrt(np.diag(normal))
        inverse = np.linalg.pinv(normal / np.outer(scale, scale), rcond=1e-14)
        inverse /= np.outer(scale, scale)
        b = (inverse @ weighted[free]).reshape(-1, n, n, bins)
        found = self._spread(b)
        systematics = list(self.estimate.systematics)
        if self.doubt:
            found += np.outer(inverse[-1], inverse[-1]) / self.doubt**2
            # Whether torque that doesn't jump with commands is late is unknown; see the M-B-K fit.
            M = self.values(solution)["M"][:, :, None]
            systematics.append(self.doubt * self.s * (self.impedance(solution) - M * self.s**2))
        for common in systematics:
            # The error of a correction belongs to one transducer, so it is common to a row.
            shift = np.sum((np.conj(b) * common).real, axis=(2, 3))
            found += shift @ shift.T
        for one in self.calibration.effects(self.estimate.Z):
            shift = np.sum((np.conj(b) * one).real, axis=(1, 2, 3))
            found += np.outer(shift, shift)
        errors = np.full(solution.size, math.nan)
        errors[free] = np.sqrt(np.diag(found))
        return errors

    def _slopes(self, solution: FloatArray) -> Iterator[ComplexArray]:
        for place, value in enumerate(solution):
            step = 1e-6 * max(abs(float(value)), 1e-3)
            up, down = solution.copy(), solution.copy()
            up[place] += step
            down[place] -= step
            yield (self.impedance(up) - self.impedance(down)) / (2.0 * step)

    def _spread(self, b: ComplexArray) -> FloatArray:
        """Covariance of ``Re Σ conj(b) δZ``; errors of elements and neighbouring bins correlate."""
        estimate = self.estimate
        noise = np.sqrt(estimate.noise)
        if estimate.disturbance is None or estimate.inverse is None:
            parts = [b * noise]
        else:
            # δZ = Σ_k V_k inverse_k with independent columns V_k: b is applied to a root of each.
            turned = [np.einsum("aijf,jf->aif", b, np.conj(one)) for one in estimate.inverse]
            factors = [root_of(np.moveaxis(one, 2, 0)) for one in estimate.disturbance]
            parts = [
                np.einsum("fim,aif->amf", np.conj(factor), one)
                for factor, one in zip(factors, turned, strict=True)
            ]
        stacked = np.concatenate([one.reshape(len(b), -1, one.shape[-1]) for one in parts], axis=1)
        return covariance_of_sums(stacked, estimate.bin_correlation)
