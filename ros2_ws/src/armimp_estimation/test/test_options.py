"""Options that make no sense are refused with one line that names them."""

from collections.abc import Callable

import numpy as np
import pytest

from armimp_common.errors import ConfigurationError
from armimp_estimation.arm_models import require_model
from armimp_estimation.estimators.estimate import confidence_radius
from armimp_estimation.estimators.local_polynomial import LocalPolynomialConfig
from armimp_estimation.estimators.lpm import LpmConfig
from armimp_estimation.estimators.registry import IdentifyConfig, make_estimator
from armimp_estimation.fit import FitConfig
from armimp_estimation.mbk import MBK
from armimp_estimation.spectra import WelchConfig
from armimp_estimation.torque_timing import TorqueReading

NAN, INFINITE = float("nan"), float("inf")
EYE = np.eye(2)


def of_matrices(B: np.ndarray) -> MBK:
    return MBK(M=EYE, B=B, K=EYE)


def radius(level: float) -> np.ndarray:
    return confidence_radius(np.ones(1), 11.0, level)


@pytest.mark.parametrize(
    ("make", "message", "wrong"),
    [
        (WelchConfig, "segment", {"segment": 4}),
        (WelchConfig, "overlap", {"segment": 64, "overlap": 64}),
        (WelchConfig, "overlap", {"overlap": -1}),
        *((WelchConfig, "band", {"f_low": f}) for f in (15.0, -1.0)),
        *((WelchConfig, "band", {"f_high": f}) for f in (INFINITE, NAN)),
        *((LpmConfig, "span must be positive", {"span": span}) for span in (0.0, INFINITE)),
        *(
            (LpmConfig, "weight_floor must not be negative", {"weight_floor": floor})
            for floor in (-0.1, NAN)
        ),
        (LocalPolynomialConfig, "order must not be negative, got -1", {"order": -1}),
        (LocalPolynomialConfig, "5 bins are too few .* at least 3, got 2", {"half_width": 2}),
        (LocalPolynomialConfig, "at least 6, got 5", {"order": 5, "half_width": 5}),
        *(
            (FitConfig, option, {option: value})
            for option in ("smoothing", "weight_floor")
            for value in (-0.1, NAN, INFINITE)
        ),
        (of_matrices, r"B has shape \(3, 3\), expected \(2, 2\)", {"B": np.eye(3)}),
        (of_matrices, "finite", {"B": np.full((2, 2), NAN)}),
        *((radius, "confidence level", {"level": level}) for level in (0.0, 1.0, -0.5, NAN)),
        (require_model, r"'spring'.*reflex", {"name": "spring"}),
        (
            make_estimator,
            r"unknown estimator 'welsh'.*welch_siso",
            {"name": "welsh", "config": IdentifyConfig()},
        ),
        *(
            (TorqueReading, f"TorqueReading\n{next(iter(wrong))}", wrong)
            for wrong in (
                {"delay": -1.5},
                {"cutoff": INFINITE},
                {"order": 0},
                {"actuator_lag": -1e-3},
            )
        ),
    ],
)
def test_when_an_option_makes_no_sense_expect_it_in_the_error(
    make: Callable[..., object], message: str, wrong: dict[str, object]
) -> None:
    with pytest.raises((ConfigurationError, ValueError), match=message):
        make(**wrong)
