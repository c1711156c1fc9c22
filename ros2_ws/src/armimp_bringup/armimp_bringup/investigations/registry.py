"""The investigations by name. A new one is a module with a function and a line here."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

from armimp_bringup.investigations.options import InvestigationOptions
from armimp_common.errors import ConfigurationError

_MODULES = {
    "coverage": "whether the standard errors of M, B and K are honest",
    "limits": "how far the estimators are from the accuracy that noise allows",
    "controller": "what the choice of the controller's parameters does to accuracy",
    "decomposition": "what decomposition buys: direct, decomposed and all joints at once",
    "growth": "accuracy, time and record length from two to seven joints",
}


def investigations() -> dict[str, str]:
    """Names of all investigations, and what each finds out."""
    return dict(_MODULES)


def find_investigation(name: str) -> Callable[[InvestigationOptions], int]:
    """The function that runs an investigation and returns its exit status.

    Raises
    ------
    ConfigurationError
        If there is none of that name.
    """
    if name not in _MODULES:
        raise ConfigurationError(f"unknown investigation {name!r}, known are {', '.join(_MODULES)}")
    run: Callable[[InvestigationOptions], int] = import_module(
        f"armimp_bringup.investigations.{name}"
    ).investigate
    return run
