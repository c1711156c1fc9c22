"""Models beyond M, B and K recover what was planted, and are offered where data support them."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from armimp_common.arrays import ComplexArray, FloatArray
from armimp_common.errors import DataError
from armimp_estimation.arm_models import AUTO, MODELS, ModelFit, fit_models, supported
from armimp_estimation.estimators.estimate import ImpedanceEstimate
from armimp_estimation.fit import Calibration, fit_impedance
from armimp_estimation.problems import ProblemCode
from armimp_estimation.verdict import judge_models
from support.synthetic_trials import TWO_JOINT_ARM, made_estimate

F = np.linspace(0.15, 15.0, 150)
S: ComplexArray = np.asarray(2j * np.pi * F, dtype=np.complex128)
INTRINSIC = {name: getattr(TWO_JOINT_ARM, name) for name in "MBK"}
PLANTED: Mapping[str, Mapping[str, FloatArray]] = {
    "mbk_delay": {"delay": np.array(0.012)},
    "reflex": {
        "velocity_gain": np.diag([0.3, 0.2]),
        "stretch_gain": np.zeros((2, 2)),
        "delay": np.array(0.04),
        "muscle": np.array(50.0),
        "damping_ratio": np.array(1.0),
    },
    "cuff": {"cuff_stiffness": np.array([5e3, 3e3]), "cuff_damping": np.array([10.0, 6.0])},
}
RESULTS = ("velocity_gain", "delay", "cuff_stiffness", "M", "B", "K")


def measured(name: str, seed: int, noise: float = 0.01) -> ImpedanceEstimate:
    """Impedance of a planted arm with independent errors in proportion to it."""
    Z = MODELS[name].impedance({**INTRINSIC, **PLANTED[name]}, S)
    variance = (noise * np.abs(Z)) ** 2
    rng = np.random.default_rng(seed)
    errors = rng.standard_normal((2, *Z.shape)) * np.sqrt(variance / 2.0)
    exact = made_estimate(F, Z, noise=variance, averages=1000.0, weight_floor=0.0, unbiased=True)
    return replace(exact, Z=Z + errors[0] + 1j * errors[1])


def fits_of(
    estimate: ImpedanceEstimate, asked: str = AUTO, calibration: Calibration | None = None
) -> dict[str, ModelFit]:
    known = calibration or Calibration()
    _, plain = fit_impedance(estimate, known)
    return fit_models(asked, estimate, plain, known)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("mbk_delay", marks=pytest.mark.slow),
        "reflex",
        pytest.param("cuff", marks=pytest.mark.slow),
    ],
)
def test_the_planted_model_is_the_one_that_the_data_support_and_its_values_come_back(
    name: str,
) -> None:
    found = fits_of(measured(name, seed=1))

    assert supported(found) == name
    best = found[name].parameters
    truth = {**INTRINSIC, **PLANTED[name]}
    assert np.abs(best["M"].values / truth["M"].ravel() - 1.0).max() < 0.03
    assert np.abs(best["K"].values / truth["K"].ravel() - 1.0).max() < 0.03
    if name == "reflex":
        assert abs(best["delay"].values[0] - 0.04) < 3e-3
        assert best["velocity_gain"].values[::3] == pytest.approx([0.3, 0.2], rel=0.1)
    if name == "cuff":
        assert best["cuff_stiffness"].values == pytest.approx([5e3, 3e3], rel=0.1)


def test_a_model_without_a_resolved_parameter_is_offered_only_if_it_was_declared() -> None:
    (fit,) = fits_of(measured("mbk_delay", seed=1), asked="mbk_delay").values()
    delay = fit.parameters["delay"].model_copy(update={"errors": [0.01]})
    vague = fit.model_copy(update={"parameters": {**fit.parameters, "delay": delay}})
    codes = {}
    for name, one in (("clear", fit), ("vague", vague)):
        for declared in (True, False):
            (told,) = judge_models(
                "lpm_full", {"mbk_delay": one.model_copy(update={"declared": declared})}
            )
            codes[name, declared] = told.code
            assert ("the data support the model" in told.sentence) is (
                told.code is ProblemCode.MODEL_OFFERED
            )
    assert fit.declared
    assert codes == {
        ("clear", True): ProblemCode.MODEL_DECLARED,
        ("clear", False): ProblemCode.MODEL_OFFERED,
        ("vague", True): ProblemCode.MODEL_DECLARED,
        ("vague", False): ProblemCode.NO_MODEL,
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", PLANTED)
def test_intervals_of_a_model_hold_what_was_planted(name: str) -> None:
    scores: list[float] = []
    truth = {**INTRINSIC, **PLANTED[name]}
    for seed in range(12):
        (fit,) = fits_of(measured(name, seed), asked=name).values()
        for one in set(RESULTS) & set(truth):
            fitted = fit.parameters[one]
            values, errors = np.array(fitted.values), np.array(fitted.errors)
            free = errors > 0.0
            scores += list(((values - truth[one].ravel()) / errors)[free])
    assert 0.8 < np.std(scores) < 1.2
    assert np.mean(np.abs(scores) < 1.96) > 0.9


def test_models_with_more_parameters_than_the_data_are_not_fitted() -> None:
    whole, few = measured("reflex", seed=1), np.s_[:1, :1, ::60]
    estimate = replace(whole, f=F[::60], Z=whole.Z[few], noise=whole.noise[few])
    _, plain = fit_impedance(estimate)
    assert not plain.of_form
    assert "reflex" not in fits_of(estimate)
    with pytest.raises(DataError, match="frequencies are too few to fit the model reflex"):
        fits_of(estimate, "reflex")


def test_where_m_b_and_k_fit_no_other_model_is_tried() -> None:
    estimate = measured("mbk_delay", seed=1)
    noise = estimate.Z - estimate.T
    assert fits_of(replace(estimate, Z=TWO_JOINT_ARM.impedance(F) + noise)) == {}


def test_uncertain_calibrations_widen_intervals_but_hide_no_lack_of_fit() -> None:
    estimate = measured("mbk_delay", seed=1, noise=1e-3)
    _, exact = fit_impedance(estimate)
    known = Calibration(gain=0.02, cross_talk=0.01, angle=0.03)
    _, loose = fit_impedance(estimate, known)

    K = exact.mbk.K
    of_scale = 0.02**2 + 0.03**2
    expected = np.sqrt(exact.errors[2] ** 2 + of_scale * K**2 + (0.01 * K[::-1]) ** 2)
    assert loose.errors[2] == pytest.approx(expected, rel=0.01)
    of_scales = (loose.covariance - exact.covariance)[8:10, 10:12]  # of K_1j and K_2j
    assert np.diag(of_scales) == pytest.approx(0.03**2 * K[0] * K[1], rel=0.01)
    assert np.array_equal(loose.lack, exact.lack)
    assert np.array_equal(loose.mbk.K, exact.mbk.K)
    sharp, blunt = (
        fits_of(estimate, "mbk_delay", one)["mbk_delay"].parameters["K"] for one in (None, known)
    )
    K = np.reshape(sharp.values, K.shape)
    others = of_scale * K**2 + (0.01 * K[::-1]) ** 2
    wider = np.sqrt(np.square(sharp.errors) + others.ravel())
    assert blunt.errors == pytest.approx(wider, rel=0.05)
