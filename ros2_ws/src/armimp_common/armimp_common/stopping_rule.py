"""Whether a trial has lasted long enough, as the estimator says it on its topic ``judgement``."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from armimp_common.errors import ConfigurationError, MalformedMessageError

JUDGEMENT_NAME: Final = "impedance_estimator: judgement"
"""``name`` of the DiagnosticStatus that carries a judgement."""

NOTICE_TICKS: Final = 200
"""Perturbed samples that follow those which were judged.

The judgement is made and travels meanwhile, and everybody hears of the end before it comes.
"""

_BOOLEANS: Final = {"true": True, "false": False}


@dataclass(frozen=True, kw_only=True)
class StoppingDecision:
    """What the estimator makes of the first samples of a trial.

    Parameters
    ----------
    trial
        Number of the trial, from 1.
    samples
        Perturbed samples that were judged; 0 announces the first judgement.
    enough
        Whether all relative standard errors are below the bound.
    due
        Number of samples at which the next judgement is made; None if there will be none.
    bound
        Largest relative standard error that is enough.
    largest
        Largest one there is; NaN if it is not known.
    element
        Where it is, such as ``K21``; empty if it is not known.

    Raises
    ------
    ConfigurationError
        If a number is negative, or the next judgement is due before this one.
    """

    trial: int
    samples: int
    enough: bool
    due: int | None
    bound: float
    largest: float = math.nan
    element: str = ""

    def __post_init__(self) -> None:
        if self.trial < 1 or self.samples < 0:
            raise ConfigurationError(f"trial {self.trial} cannot be judged at {self.samples}")
        if self.due is not None and self.due <= self.samples:
            raise ConfigurationError(f"due at {self.due} samples, after {self.samples}")

    @property
    def sentence(self) -> str:
        """The judgement in words."""
        if not self.samples:
            return f"trial {self.trial}: ends once standard errors are below {self._bound}"
        found = "not known"
        if not math.isnan(self.largest):
            found = f"{100.0 * self.largest:.3g} % ({self.element})"
        verb = "is" if self.enough else "is not"
        return f"trial {self.trial}: largest standard error {found} {verb} below {self._bound}"

    @property
    def _bound(self) -> str:
        return f"{100.0 * self.bound:g} %"

    def to_values(self) -> dict[str, str]:
        """Return the key-values of the DiagnosticStatus."""
        return {
            "trial": str(self.trial),
            "samples": str(self.samples),
            "enough": "true" if self.enough else "false",
            "due": "" if self.due is None else str(self.due),
            "bound": repr(float(self.bound)),
            "largest": repr(float(self.largest)),
            "element": self.element,
        }

    @classmethod
    def from_values(cls, values: Mapping[str, str]) -> "StoppingDecision":
        """Rebuild a judgement from its key-values; keys that are not known are ignored.

        Raises
        ------
        MalformedMessageError
            If a value is missing, cannot be parsed, or contradicts another.
        """
        try:
            return cls(
                trial=int(values["trial"]),
                samples=int(values["samples"]),
                enough=_BOOLEANS[values["enough"]],
                due=int(values["due"]) if values["due"] else None,
                bound=float(values["bound"]),
                largest=float(values["largest"]),
                element=values["element"],
            )
        except KeyError as error:
            raise MalformedMessageError(f"judgement: {error} is missing or not known") from None
        except (ValueError, ConfigurationError) as error:
            raise MalformedMessageError(f"judgement: {error}") from None
