"""The estimators by name. A new one is a file with its class and a line here."""

from collections.abc import Callable
from dataclasses import dataclass, field

from armimp_common.errors import ConfigurationError
from armimp_estimation.arm_models import AUTO, require_model
from armimp_estimation.estimators.direct import Direct
from armimp_estimation.estimators.estimate import Estimator
from armimp_estimation.estimators.lpm import LpmConfig, LpmFull
from armimp_estimation.estimators.welch import WelchFull, WelchSiso
from armimp_estimation.fit import Calibration
from armimp_estimation.mbk import MBK


@dataclass(frozen=True, kw_only=True)
class IdentifyConfig:
    """Options of an identification.

    Raises
    ------
    ConfigurationError
        If there is no such model.
    """

    lpm: LpmConfig = field(default_factory=LpmConfig)
    """Options of the estimator ``lpm_full``."""
    model: str = AUTO
    """Model of the arm to fit beside M, B and K, see :mod:`armimp_estimation.arm_models`; by
    default those that it takes where M, B and K don't fit."""
    calibration: Calibration = field(default_factory=Calibration)
    """What is known of the torque transducers."""
    target: MBK | None = None
    """Target impedance of the law, if it is known; a score compares the robot with its
    diagonal."""

    def __post_init__(self) -> None:
        require_model(self.model)


_FACTORIES: dict[str, Callable[[IdentifyConfig], Estimator]] = {
    "welch_siso": lambda _: WelchSiso(),
    "welch_full": lambda _: WelchFull(),
    "lpm_full": lambda c: LpmFull(config=c.lpm),
    "direct": lambda _: Direct(),
}


def estimator_names() -> tuple[str, ...]:
    """Names that :func:`make_estimator` knows, in the order of tables."""
    return tuple(_FACTORIES)


def make_estimator(name: str, config: IdentifyConfig) -> Estimator:
    """Estimator of that name.

    Raises
    ------
    ConfigurationError
        If there is none; the message lists those there are.
    """
    if name not in _FACTORIES:
        raise ConfigurationError(
            f"unknown estimator {name!r}, known are {', '.join(estimator_names())}"
        )
    return _FACTORIES[name](config)
