"""The estimators by name. To add one, write a module with its class and add it to `ESTIMATORS`."""

from collections.abc import Mapping, Sequence
from typing import Final

from armimp_common.errors import ConfigurationError
from armimp_estimation.estimators.estimate import Estimator
from armimp_estimation.estimators.lpm import LpmFull
from armimp_estimation.estimators.welch import WelchFull, WelchSiso

_EACH: tuple[Estimator, ...] = (
    WelchSiso(),
    WelchFull(),
    LpmFull(),
)
ESTIMATORS: Final[Mapping[str, Estimator]] = {one.name: one for one in _EACH}
"""By name, in the order in which tables list them."""


def make_estimators(estimators: Sequence[str | Estimator]) -> list[Estimator]:
    """Make the estimators that are given by name; others are taken as they are.

    Parameters
    ----------
    estimators : sequence of str or Estimator
        Names, or custom estimators.

    Raises
    ------
    ConfigurationError
        If there is none, one twice, or one of unknown name.
    """
    for one in estimators:
        if isinstance(one, str) and one not in ESTIMATORS:
            known = ", ".join(ESTIMATORS)
            raise ConfigurationError(f"unknown estimator {one!r}, known are {known}")
    made = [ESTIMATORS[one] if isinstance(one, str) else one for one in estimators]
    names = [one.name for one in made]
    if not names or len(set(names)) != len(names):
        raise ConfigurationError(f"estimators must be distinct, at least one: {names}")
    return made
