"""The human arm: a linear multi-joint impedance about a posture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armimp_common.errors import ConfigurationError


@dataclass(frozen=True, kw_only=True, eq=False)
class HumanArm:
    """τ_h = M_h θ̈ + B_h θ̇ + K_h (θ − θ_0), eq. 1–3 of the paper.

    The matrices are general: nothing here assumes or makes them symmetric.

    Raises
    ------
    ConfigurationError
        If shapes disagree, a value is not finite, or a diagonal inertia is not positive.
    """

    posture: NDArray[np.float64]
    """(n,) θ_0, rad."""
    inertia: NDArray[np.float64]
    """(n, n) M_h, kg·m²."""
    damping: NDArray[np.float64]
    """(n, n) B_h, N·m·s/rad."""
    stiffness: NDArray[np.float64]
    """(n, n) K_h, N·m/rad."""

    def __post_init__(self) -> None:
        n = self.posture.size
        if self.posture.shape != (n,) or not 1 <= n <= 7:
            raise ConfigurationError(f"arm: posture needs 1 to 7 joints, got {self.posture.shape}")
        for name in ("inertia", "damping", "stiffness"):
            matrix = getattr(self, name)
            if matrix.shape != (n, n):
                raise ConfigurationError(f"arm: {name} is {matrix.shape}, expected {(n, n)}")
        for name in ("posture", "inertia", "damping", "stiffness"):
            values = getattr(self, name)
            if not np.all(np.isfinite(values)):
                raise ConfigurationError(f"arm: {name} is not finite: {values.tolist()}")
        for i, value in enumerate(np.diag(self.inertia)):
            if not value > 0.0:
                raise ConfigurationError(
                    f"arm: inertia of joint {i + 1} must be positive, got {value}"
                )

    @property
    def joints(self) -> int:
        """Number of joints n."""
        return self.posture.size
