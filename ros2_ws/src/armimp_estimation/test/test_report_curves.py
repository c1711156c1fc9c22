"""What plots show of a curve or a signal."""

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from armimp_estimation.estimators.estimate import confidence_radius
from armimp_estimation.mbk import MBK
from armimp_estimation.report.plots import bode_chart, envelope, phase_of, rows_of
from armimp_estimation.scores import Coherences
from armimp_estimation.summary import ImpedanceCurve
from support import known
from support.synthetic_trials import (
    TWO_JOINT_ARM,
    SyntheticConfig,
    made_estimate,
    part_of,
    synthetic_trial,
)

F = np.linspace(0.1, 15.0, 40)


def stored(z: complex | np.ndarray, deviation: float = 0.1) -> ImpedanceCurve:
    values = np.broadcast_to(np.asarray(z, dtype=np.complex128), (1, 1, F.size))
    flat, variance = np.zeros((1, 1, F.size)), np.full((1, 1, F.size), deviation**2)
    made = made_estimate(F, values, noise=variance)
    coherence = Coherences(f=F, motion=flat[0], torque=flat, derived=flat)
    names = {field.name for field in fields(ImpedanceCurve)} - {"coherence"}
    return ImpedanceCurve(**{name: getattr(made, name) for name in names}, coherence=coherence)


def test_estimates_are_compared_with_the_truth_or_else_with_the_best_of_them() -> None:
    curves = {"welch_siso": stored(5.05), "lpm_full": stored(5.0, deviation=0.01)}
    truth = MBK(M=np.zeros((1, 1)), B=np.zeros((1, 1)), K=np.full((1, 1), 4.9))
    other, best = (one for one in bode_chart(curves, None, 0, 0).lines if one.row == 3)
    np.testing.assert_allclose(other.y, 1.0)
    circle = confidence_radius(curves["welch_siso"].variance[0, 0], curves["welch_siso"].averages)
    np.testing.assert_allclose(known(other.ends)[1], 20.0 * circle)
    assert np.isnan(best.y).all()
    chart = bode_chart(curves, truth, 0, 0)
    *_, off = (one.y for one in chart.lines if one.row == 3)
    np.testing.assert_allclose(off, 100.0 * (5.0 / 4.9 - 1.0))
    ends = known(chart.rows[2][1].ends)
    assert ends[0] < off.min()
    assert ends[1] > off.max()


@pytest.mark.parametrize("turns", [-2, -1, 1, 2])
def test_phase_is_shown_in_the_turn_next_to_zero(turns: int) -> None:
    # Noise in the first bin decides in which turn the unwrapped phase begins.
    ramp = np.linspace(0.0, np.pi, F.size)
    ramp[0] += turns * 0.99 * np.pi
    assert abs(np.median(phase_of(np.exp(1j * ramp))) - 90.0) < 10.0


@given(
    st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=200),
    st.integers(1, 20),
    st.sets(st.integers(0, 199)),
)
def test_an_envelope_keeps_the_extremes_of_a_signal_whatever_its_gaps(
    values: list[float], buckets: int, gaps: set[int]
) -> None:
    signal = np.array(values)
    signal[[gap for gap in gaps if gap < signal.size]] = np.nan
    thinned, step = envelope(signal, buckets)

    assert thinned.size <= 2 * buckets
    assert thinned.size * step >= signal.size
    known, kept = signal[np.isfinite(signal)], thinned[np.isfinite(thinned)]
    if known.size:
        assert kept.min() == known.min()
        assert kept.max() == known.max()
    else:
        assert kept.size == 0


def test_a_gap_between_segments_stays_a_gap() -> None:
    record = synthetic_trial(TWO_JOINT_ARM, 1, SyntheticConfig(samples=100), seed=1)
    shifted = replace(record, start_ns=5_000_000)
    parts = [part_of(shifted, 0, 40), part_of(shifted, 50, 100)]
    perturbation, angle, held, torque = rows_of(parts, start_ns=0, cutoff=None)

    assert (perturbation.joints, angle.joints, held.joints) == ((1,), (1,), (0,))
    assert torque.joints == (0, 1)
    gaps = np.isnan(torque.values[0])
    assert np.flatnonzero(gaps).tolist() == [*range(5), *range(45, 55)]
    np.testing.assert_array_equal(torque.values[:, 55:], record.torque[:, 50:])
    np.testing.assert_allclose(np.nanmean(angle.values), 0.0, atol=1e-12)
    # Degrees.
    expected = np.degrees(np.ptp(record.position[1, 50:]))
    assert np.ptp(angle.values[0, 55:]) == pytest.approx(expected)


def test_signals_are_seen_in_the_band_of_the_perturbation_neither_early_nor_late() -> None:
    record = synthetic_trial(TWO_JOINT_ARM, 1, SyntheticConfig(samples=4000), seed=1)
    time = np.arange(4000) / 1000.0
    slow, chatter = np.sin(2 * np.pi * 5.0 * time), 20.0 * np.sin(2 * np.pi * 400.0 * time)
    torque = rows_of([replace(record, torque=np.stack([slow + chatter] * 2))], record.start_ns)[-1]
    np.testing.assert_allclose(torque.values[0, 500:-500], slow[500:-500], atol=0.02)
