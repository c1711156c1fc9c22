"""Sampled stability of the law, checked before it is allowed to move anything."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from armimp_common.errors import ConfigurationError
from armimp_control.laws.imbic import ImbicConfig
from armimp_control.laws.law import LawConfig
from armimp_control.laws.layout import DAMPING, INERTIA, SENSED, STIFFNESS
from armimp_control.rig_dynamics import RigDynamics

LIMIT = 2.0
WARNING_SHARE = 0.8
"""Share of the limit from which on a warning is due."""
_GROWTH = 1e-4
"""Growth per tick taken for rounding: a target without stiffness and damping has exactly none."""


@dataclass(frozen=True, kw_only=True)
class StabilityMargins:
    """How far a sampled loop is from instability.

    The first two numbers must stay below 2; they are simple, but hold only for a soft target and
    small Γ, and exist for IMBIC alone. The third must stay below 1 and takes all of the law into
    account.

    Attributes
    ----------
    time_delay_estimation : largest |eigenvalue| of (M_r + M_h)⁻¹ M̄; None without such a model
    force_feedback : per joint, M̄_kk M_h,kk / (M_rd,k (M_r + M_h)_kk) while joint k is perturbed;
        empty without feedback of the measured torque
    spectral_radius : per joint, of the sampled loop while joint k is perturbed
    warnings : sentences for values near the edge
    """

    time_delay_estimation: float | None
    force_feedback: tuple[float, ...]
    spectral_radius: tuple[float, ...]
    warnings: tuple[str, ...]


def check_stability(
    config: LawConfig,
    *,
    robot_inertia: NDArray[np.float64],
    arm_inertia: NDArray[np.float64],
    dynamics: RigDynamics | None = None,
) -> StabilityMargins:
    """Check the sampled loop with every joint perturbed in turn.

    The condition is that the loop of law and inertia returns to rest, see :func:`spectral_radius`;
    for IMBIC also λmax((M_r + M_h)⁻¹ M̄) < 2 and M̄ M_h/(M_rd (M_r + M_h)) < 2.

    Parameters
    ----------
    config : ImbicConfig or PdConfig
    robot_inertia : (n, n) M_r(θ_0), kg·m²
    arm_inertia : (n, n) M_h as far as it is known beforehand, kg·m²
    dynamics : of drives and transducers; by default they are prompt

    Raises
    ------
    ConfigurationError
        If a condition is violated or the inertia makes no sense; the message carries the value.
    """
    total = _total_inertia(config.joints, robot_inertia, arm_inertia)
    if isinstance(config, ImbicConfig):
        values, gains = _simple_conditions(config, total, arm_inertia), "M̄"
    else:
        values, gains = {}, "gains"
    warnings = [
        f"{name} = {value:.3g} is close to its stability limit {LIMIT:g}"
        for name, value in values.items()
        if not value < WARNING_SHARE * LIMIT
    ]
    known = dynamics or RigDynamics()
    later = replace(known, torque_delay=known.torque_delay + config.period)
    later_command = replace(known, command_delay=known.command_delay + 1)

    def radius_of(k: int, assumed: RigDynamics, gain: float = 1.0) -> float:
        return spectral_radius(
            config,
            perturbed=k,
            robot_inertia=robot_inertia,
            arm_inertia=arm_inertia,
            gain=gain,
            dynamics=assumed,
        )

    radii = []
    for k in range(config.joints):
        radius = radius_of(k, known)
        if not radius < 1.0 + _GROWTH:
            raise ConfigurationError(
                "controller: unstable when sampled: while joint "
                f"{k + 1} is perturbed, motion grows by a factor of {radius:.4g} per tick"
                + _with(known)
            )
        if not radius_of(k, known, 1.0 / WARNING_SHARE) < 1.0 + _GROWTH:
            warnings.append(
                f"with {gains} larger by {1.0 / WARNING_SHARE - 1.0:.0%} the loop would be "
                f"unstable while joint {k + 1} is perturbed"
            )
        if not known.none and not radius_of(k, later) < 1.0 + _GROWTH:
            warnings.append(
                f"with torques read {1e3 * config.period:g} ms later the loop would be unstable "
                f"while joint {k + 1} is perturbed"
            )
        if known.command_delay and not radius_of(k, later_command) < 1.0 + _GROWTH:
            warnings.append(
                f"with commands that act {1e3 * config.period:g} ms later the loop would be "
                f"unstable while joint {k + 1} is perturbed"
            )
        radii.append(radius)
    return StabilityMargins(
        time_delay_estimation=next(iter(values.values()), None),
        force_feedback=tuple(values.values())[1:],
        spectral_radius=tuple(radii),
        warnings=tuple(warnings),
    )


def _simple_conditions(
    config: ImbicConfig, total: NDArray[np.float64], arm_inertia: NDArray[np.float64]
) -> dict[str, float]:
    """Check the conditions on M̄ alone; their values by name."""
    eigenvalues = np.linalg.eigvals(np.linalg.solve(total, config.model_inertia))
    if not np.min(eigenvalues.real) > 0.0:
        raise ConfigurationError(
            "controller: (M_r + M_h)⁻¹ M̄ needs eigenvalues with positive real parts, "
            f"got {np.min(eigenvalues.real):.3g}"
        )
    values = {"λmax((M_r + M_h)⁻¹ M̄)": float(np.max(np.abs(eigenvalues)))}
    for k in range(config.joints):
        values[f"M̄ M_h/(M_rd (M_r + M_h)) of joint {k + 1}"] = float(
            config.model_inertia[k, k]
            * arm_inertia[k, k]
            / (config.target_inertia[k] * total[k, k])
        )
    for name, value in values.items():
        if not value < LIMIT:
            raise ConfigurationError(
                f"controller: unstable when sampled: {name} = {value:.3g}, must be below {LIMIT:g}"
            )
    return values


def spectral_radius(
    config: LawConfig,
    *,
    perturbed: int,
    robot_inertia: NDArray[np.float64],
    arm_inertia: NDArray[np.float64],
    gain: float = 1.0,
    dynamics: RigDynamics | None = None,
) -> float:
    """Largest factor by which a deviation from rest can grow from tick to tick.

    Exact for the laws as coded on a rig that consists of inertia only, with torque held between
    ticks and sensors read just before it changes; or with the given dynamics of drives and
    transducers.

    Parameters
    ----------
    config : ImbicConfig or PdConfig
    perturbed : joint that yields, 0-based
    robot_inertia, arm_inertia : (n, n) M_r(θ_0) and M_h, kg·m²
    gain : factor on M̄, or on the gains of a law without it
    dynamics : of drives and transducers; by default they are prompt
    """
    n, period = config.joints, config.period
    rig = (dynamics or RigDynamics()).sampled(period)
    # A prompt reading is that of the last command, which is part of the state anyway.
    late = rig.delay + 1 if dynamics is not None and not dynamics.none else 0
    delay = 0 if dynamics is None else dynamics.command_delay
    count = 6 + rig.states + late + delay
    role = config.role(perturbed)
    per_inertia = np.linalg.inv(robot_inertia + arm_inertia)
    # Everything is linear in the state: each of these (n, count·n) gives one vector of it.
    vectors = np.eye(count * n).reshape(count, n, count * n)
    theta, velocity, theta_1, theta_2, ideal, torque = vectors[:6]
    states, readings, under_way = np.split(vectors[6:], [rig.states, rig.states + late])
    sensed_torque = readings[-1] if late else torque
    measured = (theta - theta_1) / period
    if isinstance(config, ImbicConfig):
        sensed, damping, stiffness = (
            np.diag(role[row] / role[INERTIA]) for row in (SENSED, DAMPING, STIFFNESS)
        )
        load = arm_inertia @ per_inertia @ sensed_torque
        u = -sensed @ load - damping @ measured - stiffness @ theta
        ideal = ideal + period * u
        delayed = (theta - 2.0 * theta_1 + theta_2) / period**2
        torque = torque + gain * config.model_inertia @ (
            u + config.gamma * (ideal - measured) - delayed
        )
    else:
        damping, stiffness = np.diag(role[DAMPING]), np.diag(role[STIFFNESS])
        torque = -gain * (damping @ measured + stiffness @ theta)
        ideal = np.zeros_like(ideal)
    acting = under_way[-1] if delay else torque
    drive = states[0] if rig.drive_lags else np.zeros_like(torque)
    newest = np.tensordot(rig.reading_from_state, states, 1) + rig.reading_from_command * acting
    following = (
        theta + period * velocity + per_inertia @ (rig.way[0] * drive + rig.way[1] * acting),
        velocity + per_inertia @ (rig.speed[0] * drive + rig.speed[1] * acting),
        theta,
        theta_1,
        ideal,
        torque,
        *(
            np.tensordot(row, states, 1) + share * acting
            for row, share in zip(rig.transition, rig.from_command, strict=True)
        ),
        *([newest, *readings[:-1]] if late else []),
        *([torque, *under_way[:-1]] if delay else []),
    )
    return float(np.max(np.abs(np.linalg.eigvals(np.concatenate(following)))))


def _with(dynamics: RigDynamics) -> str:
    """The dynamics in words, for an error that they may be the reason of."""
    if dynamics.none:
        return ""
    return (
        f", with commands that act {dynamics.command_delay} periods late, torques read "
        f"{1e3 * dynamics.torque_delay:g} ms late, a low-pass at "
        f"{dynamics.torque_cutoff:g} Hz (0: none) and drives that lag by "
        f"{1e3 * dynamics.actuator_lag:g} ms"
    )


def _total_inertia(
    n: int, robot_inertia: NDArray[np.float64], arm_inertia: NDArray[np.float64]
) -> NDArray[np.float64]:
    for name, matrix in (("M_r", robot_inertia), ("M_h", arm_inertia)):
        if matrix.shape != (n, n) or not np.all(np.isfinite(matrix)):
            raise ConfigurationError(
                f"controller: {name} needs {n}×{n} finite values: {matrix.tolist()}"
            )
    total = robot_inertia + arm_inertia
    smallest = float(np.linalg.eigvalsh(0.5 * (total + total.T))[0])
    if not smallest > 0.0:
        raise ConfigurationError(
            "controller: M_r + M_h must have a positive definite symmetric part, "
            f"its smallest eigenvalue is {smallest:.3g} kg·m²"
        )
    return total
