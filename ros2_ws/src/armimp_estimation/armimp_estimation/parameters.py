"""Parameters of the estimator node: the one place of their names, defaults and meaning."""

from __future__ import annotations

from pydantic import Field, TypeAdapter, ValidationError

from armimp_common.errors import ConfigurationError
from armimp_common.realtime import TimingLimits
from armimp_common.schema import Schema
from armimp_estimation.estimators.registry import ESTIMATORS, make_estimators


class EstimatorParameters(Schema):
    """All parameters of the node ``impedance_estimator``."""

    joints: tuple[str, ...] = ("shoulder", "elbow")
    """names of the joints, in the order of results"""
    estimators: tuple[str, ...] = Field(
        default=("welch_siso", "lpm_full"),
        description=f"Estimators of the final result, of: {', '.join(ESTIMATORS)}",
    )
    record: bool = True
    """write one bag for each trial"""
    directory: str = ""
    """where bags/, summary.json and frf.npz go; empty: nowhere"""
    metadata: str = "{}"
    """JSON object of strings to store in the bags: configuration, truth, versions and more"""
    allow_gaps: bool = False
    """estimate from the intact parts of trials that lost samples"""
    realtime: TimingLimits = TimingLimits()
    target_error: float = Field(default=0.0, ge=0.0, lt=1.0)
    """relative standard error below which a trial ends early; 0: never"""
    least_duration: float = Field(default=20.0, gt=0.0, le=9000.0)
    """least length of a trial that ends early (s)"""

    def bag_metadata(self) -> dict[str, str]:
        """Return the metadata as a dictionary.

        Raises
        ------
        ConfigurationError
            If `metadata` is not a JSON object of strings, or `estimators` can't be used.
        """
        make_estimators(self.estimators)
        try:
            return TypeAdapter(dict[str, str]).validate_json(self.metadata)
        except ValidationError:
            raise ConfigurationError(
                f"parameter 'metadata' is not a JSON object of strings: {self.metadata[:60]!r}"
            ) from None
