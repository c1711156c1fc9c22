"""The estimators by name. To add one, write a module with its class and add a line here."""

from collections.abc import Callable
from dataclasses import dataclass, field

from armimp_common.errors import ConfigurationError
from armimp_estimation.arm_models import AUTO, require_model
from armimp_estimation.estimators.direct import Direct
from armimp_estimation.estimators.estimate import Estimator
from armimp_estimation.estimators.lpm import LpmFull
from armimp_estimation.estimators.welch import WelchFull, WelchSiso
from armimp_estimation.fit import Calibration
from armimp_estimation.mbk import MBK


@dataclass(frozen=True, kw_only=True)
class IdentifyConfig:
    """Options of an identification.

    Raises
    ------
    ConfigurationError
        If there is no model of that name.
    """

    lpm: LpmFull = field(default_factory=LpmFull)
    """The estimator ``lpm_full``, as torques were read."""
    model: str = AUTO
    """Model of the arm to fit in addition to M, B and K, see :mod:`armimp_estimation.arm_models`.
    By default, all models are tried where M, B and K don't fit."""
    calibration: Calibration = field(default_factory=Calibration)
    """Uncertainties of the torque transducers and encoders."""
    target: MBK | None = None
    """Target impedance of the control law, if known. A score compares the robot's impedance with
    its diagonal."""

    def __post_init__(self) -> None:
        require_model(self.model)


_FACTORIES: dict[str, Callable[[IdentifyConfig], Estimator]] = {
    "welch_siso": lambda _: WelchSiso(),
    "welch_full": lambda _: WelchFull(),
    "lpm_full": lambda c: c.lpm,
    "direct": lambda _: Direct(),
}


def estimator_names() -> tuple[str, ...]:
    """Names that :func:`make_estimator` knows, in the order in which tables list them."""
    return tuple(_FACTORIES)


def make_estimator(name: str, config: IdentifyConfig) -> Estimator:
    """Make the estimator of a name.

    Raises
    ------
    ConfigurationError
        If the name is unknown; the message lists the known ones.
    """
    if name not in _FACTORIES:
        raise ConfigurationError(
            f"unknown estimator {name!r}, known are {', '.join(estimator_names())}"
        )
    return _FACTORIES[name](config)
