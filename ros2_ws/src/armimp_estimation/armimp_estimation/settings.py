"""All options of an identification in one place."""

from dataclasses import dataclass, field

from armimp_estimation.estimators.lpm import LpmConfig
from armimp_estimation.fit import FitConfig
from armimp_estimation.spectra import WelchConfig
from armimp_estimation.verdict import Limits


@dataclass(frozen=True, kw_only=True)
class IdentifyConfig:
    """Options of the spectra, of the parametric fit, and limits of the verdict.

    Parameters
    ----------
    welch : WelchConfig
        Segments and band.
    lpm : LpmConfig
        Options of the estimator ``lpm_full``, which takes the same band.
    fit : FitConfig
        Fit of M, B and K.
    limits : Limits
        What a valid result has to meet.
    """

    welch: WelchConfig = field(default_factory=WelchConfig)
    lpm: LpmConfig = field(default_factory=LpmConfig)
    fit: FitConfig = field(default_factory=FitConfig)
    limits: Limits = field(default_factory=Limits)
