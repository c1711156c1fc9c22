"""The estimators by name. A new one is a file with its class and a line here."""

from collections.abc import Callable

from armimp_common.errors import ConfigurationError
from armimp_estimation.estimators.direct import Direct
from armimp_estimation.estimators.estimate import Estimator
from armimp_estimation.estimators.lpm import LpmFull
from armimp_estimation.estimators.welch import WelchFull, WelchSiso
from armimp_estimation.settings import IdentifyConfig

_FACTORIES: dict[str, Callable[[IdentifyConfig], Estimator]] = {
    "welch_siso": lambda _: WelchSiso(),
    "welch_full": lambda _: WelchFull(),
    "lpm_full": lambda c: LpmFull(config=c.lpm, band=(c.welch.f_low, c.welch.f_high)),
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
