"""The compiled plant: equations of motion and RK4, for many trials side by side.

Each trial has a lane, and lanes are grouped in blocks of equal width. The numbers of a batch fill
an array (blocks, quantities, width), with a place in each quantity for each lane of a block. A
block goes through a whole control period on its own, so its numbers stay in the processor's
registers and first-level cache. The width and the number of joints n are compile-time constants,
carried by the lengths of two tuples; arithmetic is on all lanes of a block at once
(:mod:`armimp_sim.simd`). A block of width 1 is the ordinary single trial; its arithmetic is the
same operation by operation, so a lane gives the same bits in any batch.

Places in a block (n times the width each unless said otherwise), in the order of :func:`rows`:
state θ, v, z; input τ, d; parameters; work space.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from armimp_common.arrays import FloatArray
from armimp_common.compiled import compiled, compiled_entry
from armimp_sim.model.friction import bristle_force, lugre
from armimp_sim.simd import Tag, fill, load, sine_cosine, store

WIDTH = 8
"""Lanes of a block if there are several: the widest registers hold as many. Twice as many are only
a tenth faster, and leave more lanes unused; the unused ones of the last block are at rest."""

# Vectors, in units of n rows: state, inputs, parameters, outputs, work space.
THETA, VELOCITY, BRISTLE = 0, 1, 2
COMMAND, VOLUNTARY = 3, 4
POSTURE = 5
COULOMB, STRIBECK, INVERSE_STRIBECK_VELOCITY = 6, 7, 8  # Fc, Fs − Fc, 1/vs
SIGMA_0, SIGMA_1, SIGMA_2 = 9, 10, 11
TORQUE = 12  # torque on the arm at the last sample
_START = 13  # state at the start of the RK4 step: 3 vectors
_SUM = 16  # weighted sum of the slopes: 3 vectors
_SLOPE_V, _SLOPE_Z = 19, 20
_COSINE, _SINE, _OMEGA_SQUARED = 21, 22, 23
_CENTRIPETAL, _RHS = 24, 25
VECTORS = 26
# n×n matrices follow the vectors.
INERTIA, DAMPING, STIFFNESS, CHAIN, _MASS = 0, 1, 2, 3, 4
MATRICES = 5


class Batch(NamedTuple):
    """A batch of plants, in the form that compiled code takes."""

    w: FloatArray
    """(blocks, rows(n), width) all numbers of the plants."""
    joints: Tag
    width: Tag
    """Tuples of zeros, n of them and as many as a block is wide."""
    substeps: int
    step: float
    """Number and length (s) of the RK4 steps of a period."""
    interval_mean: bool
    """Whether torque is read as the mean over the period."""
    resolutions: FloatArray
    """(lanes, 2) of encoders, rad, and torque transducers, N·m."""
    position: FloatArray
    torque: FloatArray
    """(lanes, n) readings, rad and N·m."""


class Block(NamedTuple):
    """One block of a batch, see :class:`Batch`."""

    w: FloatArray
    """(rows(n), width)"""
    joints: Tag
    width: Tag


def rows(n: int) -> int:
    """Return the number of quantities of a lane with n joints."""
    return VECTORS * n + MATRICES * n * n


@compiled
def _get(block: Block, row: int) -> float:
    return load(block.w, row * len(block.width), (block.width,))


@compiled
def _put(block: Block, row: int, value: float) -> None:
    store(block.w, row * len(block.width), value)


@compiled
def _vector(block: Block, which: int) -> float:
    """Return one quantity of all joints: where they don't act on each other, they go together."""
    joints, lanes = block.joints, block.width
    return load(block.w, which * len(joints) * len(lanes), (joints, lanes))


@compiled
def _put_vector(block: Block, which: int, values: float) -> None:
    store(block.w, which * len(block.joints) * len(block.width), values)


@compiled
def _matrix_row(which: int, i: int, j: int, n: int) -> int:
    return VECTORS * n + which * n * n + i * n + j


@compiled
def _kinematics(block: Block) -> None:
    """Compute sines and cosines of the absolute link angles, and squared absolute rates."""
    n = len(block.joints)
    # The dynamics depend on differences of angles only, so the first link is put at zero.
    angle = fill(0.0, block.width)
    rate = _get(block, VELOCITY * n)
    _put(block, _COSINE * n, fill(1.0, block.width))
    _put(block, _SINE * n, angle)
    _put(block, _OMEGA_SQUARED * n, rate * rate)
    for a in range(1, n):
        angle += _get(block, THETA * n + a)
        rate += _get(block, VELOCITY * n + a)
        s, c = sine_cosine(angle)
        _put(block, _COSINE * n + a, c)
        _put(block, _SINE * n + a, s)
        _put(block, _OMEGA_SQUARED * n + a, rate * rate)


@compiled
def _bristle_force(block: Block, v: float) -> float:
    """Return LuGre's g(v) of all joints."""
    return bristle_force(
        v,
        _vector(block, COULOMB),
        _vector(block, STRIBECK),
        _vector(block, INVERSE_STRIBECK_VELOCITY),
    )


@compiled
def _friction(block: Block) -> None:
    """Compute the slopes of the bristles' deflections, and subtract F from the right-hand side."""
    v = _vector(block, VELOCITY)
    dz, force = lugre(
        v,
        _vector(block, BRISTLE),
        _bristle_force(block, v),
        _vector(block, SIGMA_0),
        _vector(block, SIGMA_1),
        _vector(block, SIGMA_2),
    )
    _put_vector(block, _SLOPE_Z, dz)
    _put_vector(block, _RHS, _vector(block, _RHS) - force)


@compiled
def _arm(block: Block) -> None:
    """Subtract B_h θ̇ + K_h (θ − θ_0) + d from the right-hand side."""
    n = len(block.joints)
    for i in range(n):
        total = _get(block, VOLUNTARY * n + i)
        for j in range(n):
            angle = _get(block, THETA * n + j) - _get(block, POSTURE * n + j)
            total += (
                _get(block, _matrix_row(DAMPING, i, j, n)) * _get(block, VELOCITY * n + j)
                + _get(block, _matrix_row(STIFFNESS, i, j, n)) * angle
            )
        _put(block, _RHS * n + i, -total)


@compiled
def _links(block: Block) -> None:
    """Compute inertia and centripetal torque of the chain in absolute link angles φ.

    There the kinetic energy is ½ Σ_ab A_ab cos(φ_a − φ_b) φ̇_a φ̇_b with constant A. Since
    φ_a = Σ_{i≤a} θ_i, joint quantities are sums over the links from the joint outwards.
    """
    n = len(block.joints)
    for a in range(n):
        _put(block, _matrix_row(_MASS, a, a, n), _get(block, _matrix_row(CHAIN, a, a, n)))
        _put(block, _CENTRIPETAL * n + a, fill(0.0, block.width))
    for a in range(n):
        c_a, s_a = _get(block, _COSINE * n + a), _get(block, _SINE * n + a)
        for b in range(a + 1, n):
            c_b, s_b = _get(block, _COSINE * n + b), _get(block, _SINE * n + b)
            coefficient = _get(block, _matrix_row(CHAIN, a, b, n))
            cosine = coefficient * (c_a * c_b + s_a * s_b)
            _put(block, _matrix_row(_MASS, a, b, n), cosine)
            _put(block, _matrix_row(_MASS, b, a, n), cosine)
            sine = coefficient * (s_a * c_b - c_a * s_b)
            _accumulate(block, _CENTRIPETAL * n + a, sine * _get(block, _OMEGA_SQUARED * n + b))
            _accumulate(block, _CENTRIPETAL * n + b, -sine * _get(block, _OMEGA_SQUARED * n + a))


@compiled
def _drive(block: Block) -> None:
    """Add τ − C θ̇ to the right-hand side."""
    n = len(block.joints)
    outwards = fill(0.0, block.width)
    for i in range(n - 1, -1, -1):
        outwards = _get(block, _CENTRIPETAL * n + i) + outwards
        torque = _get(block, COMMAND * n + i) - outwards
        _put(block, _RHS * n + i, _get(block, _RHS * n + i) + torque)


@compiled
def _masses(block: Block) -> None:
    """Compute M_r(θ) + M_h from the inertia of the links: sum over columns, then over rows."""
    n = len(block.joints)
    first, arm = _matrix_row(_MASS, 0, 0, n), _matrix_row(INERTIA, 0, 0, n)
    for i in range(n):
        for b in range(n - 2, -1, -1):
            row = first + i * n + b
            _accumulate(block, row, _get(block, row + 1))
    for element in range(n * (n - 1) - 1, -1, -1):
        _accumulate(block, first + element, _get(block, first + element + n))
    for element in range(n * n):
        _accumulate(block, first + element, _get(block, arm + element))


@compiled
def _accumulate(block: Block, row: int, value: float) -> None:
    """Add a value to a quantity."""
    _put(block, row, _get(block, row) + value)


@compiled
def _solve(block: Block) -> None:
    """Solve θ̈ = (M_r + M_h)⁻¹ rhs by elimination.

    Without pivoting: configuration checks that the symmetric part is positive definite, for which
    elimination in the given order is stable.
    """
    n = len(block.joints)
    for p in range(n):
        pivot = _matrix_row(_MASS, p, p, n)
        inverse = 1.0 / _get(block, pivot)  # what needs the right-hand side only multiplies
        _put(block, pivot, inverse)
        for i in range(p + 1, n):
            factor = _get(block, _matrix_row(_MASS, i, p, n)) * inverse
            for j in range(p + 1, n):
                row, above = _matrix_row(_MASS, i, j, n), _matrix_row(_MASS, p, j, n)
                value = _get(block, row) - factor * _get(block, above)
                _put(block, row, value)
            value = _get(block, _RHS * n + i) - factor * _get(block, _RHS * n + p)
            _put(block, _RHS * n + i, value)
    for i in range(n - 1, -1, -1):
        total = _get(block, _RHS * n + i)
        for j in range(i + 1, n):
            total -= _get(block, _matrix_row(_MASS, i, j, n)) * _get(block, _SLOPE_V * n + j)
        _put(block, _SLOPE_V * n + i, total * _get(block, _matrix_row(_MASS, i, i, n)))


@compiled
def _slopes(block: Block) -> None:
    """Compute the time derivatives of v and z at the present state (that of θ is v itself)."""
    _kinematics(block)
    _arm(block)
    _links(block)
    _drive(block)
    _masses(block)
    _friction(block)  # last: it takes longest, and only _solve waits for it
    _solve(block)


@compiled
def rk4_step(block: Block, h: float) -> None:
    """Take one classical Runge–Kutta step of length h with constant command."""
    n = len(block.joints)
    for row in range(3 * n):
        _put(block, _START * n + row, _get(block, row))
        _put(block, _SUM * n + row, fill(0.0, block.width))
    for stage in range(4):
        # Weight of these slopes in the sum, and how far they lead to the next stage.
        weight = 2.0 if 1 <= stage <= 2 else 1.0
        ahead = 0.5 * h if stage < 2 else h
        _slopes(block)
        for row in range(3 * n):
            if row < n:
                slope = _get(block, VELOCITY * n + row)
            else:
                slope = _get(block, _SLOPE_V * n + row - n)
            total = _get(block, _SUM * n + row) + weight * slope
            _put(block, _SUM * n + row, total)
            next_value = _get(block, _START * n + row) + ahead * slope
            _put(block, row, next_value)
    for row in range(3 * n):
        total = (h / 6.0) * _get(block, _SUM * n + row)
        _put(block, row, _get(block, _START * n + row) + total)


@compiled
def sample_block(block: Block) -> None:
    """Set TORQUE = M_h θ̈ + B_h θ̇ + K_h (θ − θ_0) + d in a block, as :func:`sample_now`."""
    n = len(block.joints)
    _slopes(block)
    for i in range(n):
        total = _get(block, VOLUNTARY * n + i)
        for j in range(n):
            angle = _get(block, THETA * n + j) - _get(block, POSTURE * n + j)
            total += (
                _get(block, _matrix_row(INERTIA, i, j, n)) * _get(block, _SLOPE_V * n + j)
                + _get(block, _matrix_row(DAMPING, i, j, n)) * _get(block, VELOCITY * n + j)
                + _get(block, _matrix_row(STIFFNESS, i, j, n)) * angle
            )
        _put(block, TORQUE * n + i, total)


@compiled_entry
def sample_now(batch: Batch) -> None:
    """Put the torque on the arm at this instant, N·m, under the present command, into TORQUE."""
    for w in batch.w:
        sample_block(Block(w, batch.joints, batch.width))


@compiled_entry
def advance(batch: Batch) -> None:
    """Advance all lanes by a period, with COMMAND and VOLUNTARY held, then sample the torque."""
    for w in batch.w:
        block = Block(w, batch.joints, batch.width)
        for _ in range(batch.substeps):
            rk4_step(block, batch.step)
        sample_block(block)


@compiled_entry
def stiffness_ratio(batch: Batch) -> float:
    """Return the largest h·σ0|v|/g(v) of all joints and lanes, for the check of the step.

    It is not finite if the velocity of any joint in any lane is not.
    """
    ratios = np.empty(len(batch.joints) * len(batch.width))
    worst = 0.0
    for w in batch.w:
        block = Block(w, batch.joints, batch.width)
        v = _vector(block, VELOCITY)
        level = _bristle_force(block, v)
        store(ratios, 0, batch.step * _vector(block, SIGMA_0) * abs(v) / level)
        for ratio in ratios:
            if np.isnan(ratio):
                return np.nan
            worst = max(worst, ratio)
    return worst
