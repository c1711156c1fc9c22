"""The facade: recordings of any origin give the same result, with intervals that hold the truth."""

import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

import armimp
from armimp_bringup.offline_estimate import estimate_bags
from support.bag_files import write_bag
from support.synthetic_bags import recorded_arm, synthetic_recording

SIGNALS = ("perturbation", "position", "torque")


@pytest.fixture(scope="module")
def recording() -> armimp.Recording:
    return armimp.simulate(duration=20.0, seed=1)


@pytest.fixture(scope="module")
def result(recording: armimp.Recording) -> armimp.Result:
    return armimp.identify(recording)


def rebuilt(recording: armimp.Recording, **changes: Any) -> armimp.Recording:
    """The recording rebuilt from plain arrays, some of them replaced."""
    arrays = {name: [getattr(one, name) for one in recording.trials] for name in SIGNALS}
    return armimp.Recording.from_arrays(**{**arrays, "rate": 1000.0, **changes})


def test_intervals_hold_the_arm_that_was_simulated(
    recording: armimp.Recording, result: armimp.Result
) -> None:
    assert result.valid, result.problems
    assert recording.truth is not None
    held = 0
    for letter in ("M", "B", "K"):
        low, high = result.interval(letter, 0.999)
        true = getattr(recording.truth, letter)
        held += int(np.count_nonzero((low < true) & (true < high)))
        assert np.abs(getattr(result, letter) - true).max() < 0.05 * np.abs(true).max()
    assert held >= 11  # of twelve
    assert result.Z.shape == result.Z_variance.shape == (2, 2, result.f.size)
    assert len(repr((recording, result))) < 2000  # arrays of samples and frequencies stay out


SPOILT: dict[str, tuple[str, Callable[[np.ndarray, int], np.ndarray]]] = {
    "0 counts of its resolution": (
        "torque",
        lambda torque, k: np.where(np.arange(2)[:, None] == k, torque, 0.0),
    ),
    "jump by 6.28 rad: unwrap them": (
        "position",
        lambda angle, _: (angle - angle.mean(axis=1, keepdims=True)) % (2.0 * np.pi),
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("words", SPOILT)
def test_torques_of_the_perturbed_joint_alone_and_angles_that_wrap_are_refused(
    recording: armimp.Recording, words: str
) -> None:
    name, spoil = SPOILT[words]
    arrays = [spoil(getattr(one, name), k) for k, one in enumerate(recording.trials)]
    result = armimp.identify(rebuilt(recording, **{name: arrays}))
    assert not result.impedance_valid
    assert any(words in one for one in result.problems), result.problems


def test_intervals_are_those_of_a_normal_distribution_and_widen_with_the_level(
    result: armimp.Result,
) -> None:
    low, high = result.interval("K")
    assert np.allclose(high - low, 2 * 1.959964 * result.K_se)
    wide = result.interval("K", 0.99)
    assert (wide[0] < low).all()
    assert (wide[1] > high).all()
    with pytest.raises(armimp.ArmimpError, match=r"level 1\.0"):
        result.interval("K", 1.0)


def test_plain_arrays_give_the_bits_of_the_recording_and_the_perturbed_joint_is_found(
    recording: armimp.Recording, result: armimp.Result
) -> None:
    command = [one.command for one in recording.trials]
    made = rebuilt(recording, command=command, timing="before_update")
    assert [one.perturbed_joint for one in made.trials] == [0, 1]
    assert np.array_equal(armimp.identify(replace(made, known=recording.known)).K, result.K)


ONES = np.ones((1, 1, 5000))


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"position": ONES[:, :, 1:]}, "trial 1: position has 4999 samples"),
        ({"command": ONES[:, :, 1:]}, "trial 1: command has 4999 samples"),
        *(
            ({name: np.where(np.arange(5000) == 7, bad, ONES)}, f"{name} of joint_1 is {bad} at")
            for name, bad in zip(
                (*SIGNALS, "command"), (math.nan, math.nan, math.inf, -math.inf), strict=True
            )
        ),
        ({"joint_names": ["a", "b"]}, r"shape \(1, 5000\), expected \(2, N\)"),
        ({"joint_names": ["a", "a"]}, "distinct"),
        ({"position": np.ma.masked_array(ONES, mask=np.arange(5000) == 3)}, "nan at sample 3"),
        ({"position": ONES[0]}, "shape"),
        ({"position": ONES + 1j}, "complex"),
        ({"position": np.full(ONES.shape, "N·m")}, "no arrays of numbers"),
        ({"position": None}, "no arrays of numbers"),
        ({"calibration": {"gain": 0.1}}, "calibration must be a Calibration"),
        ({"position": np.ones((2, 1, 5000))}, r"one array for each trial, but have \[1, 2, 1\]"),
        ({"perturbation": 0.0 * ONES}, "the perturbation is zero"),
        (dict.fromkeys(SIGNALS, np.ones((1, 5000, 1))), "5000 joints"),
        ({"rate": 100.0}, "rate: 100"),
        ({"rate": "1000"}, "rate: '1000'"),
    ],
)
def test_when_arrays_are_no_trials_of_a_rig_expect_one_line_before_any_estimate(
    changed: dict[str, Any], message: str
) -> None:
    with pytest.raises(armimp.ArmimpError, match=message) as error:
        armimp.Recording.from_arrays(**(dict.fromkeys(SIGNALS, ONES) | {"rate": 1000.0} | changed))
    assert "\n" not in str(error.value)


def test_when_an_option_is_unknown_or_out_of_range_expect_its_name() -> None:
    with pytest.raises(armimp.ArmimpError, match="frictoin"):
        armimp.simulate(frictoin=3)
    with pytest.raises(armimp.ArmimpError, match="'friction' = 7"):
        armimp.simulate(friction=7)
    with pytest.raises(armimp.ArmimpError, match=r"timing: .* got 'never'"):
        armimp.Recording.from_arrays([], [], [], rate=1.0, timing="never")


def test_a_bag_becomes_a_recording_and_problems_of_its_stamps_are_those_of_the_result(
    recording: armimp.Recording, tmp_path: Path
) -> None:
    made = synthetic_recording(perturbed=(0, 1), ticks=2000, settle=10, rest=10)
    bag = write_bag(tmp_path / "bag", made.messages, {})
    read = armimp.read_bag(tmp_path)
    assert (read.problems, read.truth) == ((), None)
    assert [(one.perturbed_joint, one.samples) for one in read.trials] == [(0, 2000), (1, 2000)]
    doubted = armimp.read_bag(bag, rate=900.0)
    assert [one.code.value for one in doubted.problems] == ["rate_unplanned"] * 2
    result = armimp.identify(replace(recording, problems=doubted.problems))
    assert not result.valid
    assert "900 Hz were expected" in result.problems[0]
    with pytest.raises(armimp.ArmimpError, match="no bag"):
        armimp.read_bag()


def test_metadata_of_the_sensors_in_a_bag_count_as_on_the_command_line(
    tmp_path: Path,
) -> None:
    known = {"torque_timing": '"before_update"', "torque_uncertainty": "0.002"}
    bag = write_bag(tmp_path / "bag", recorded_arm().messages, known | {"gain_uncertainty": "0.03"})
    told = estimate_bags([bag], ("lpm_full",)).summary.estimators["lpm_full"]
    found = armimp.identify(armimp.read_bag(bag))
    for name in ("M", "B", "K", "M_se", "B_se", "K_se"):
        assert np.array_equal(getattr(found, name), getattr(told, name)), name


def test_the_model_that_a_bag_was_recorded_with_is_fitted_unless_another_one_is_asked_for(
    tmp_path: Path,
) -> None:
    bag = write_bag(tmp_path / "bag", recorded_arm().messages, {"arm_model": '"cuff"'})
    read = armimp.read_bag(bag)
    assert armimp.identify(read).models.keys() == {"cuff"}
    assert not armimp.identify(read, model="mbk").models


def test_the_declared_linearity_of_transducers_decides_the_errors_beside_a_person() -> None:
    person = {"voluntary.rms": 0.3, "substeps": 20}
    bending = {**person, "sensors.torque.hysteresis": 0.05}
    bent = armimp.simulate(duration=2.0, arm_sim=bending)
    assert bent.known.calibration.linearity is None
    recording = armimp.simulate(duration=20.0, seed=1, arm_sim=person)
    known = recording.known
    assert known.calibration.linearity == 0.0
    declared, unknown, poor = (
        armimp.identify(replace(recording, known=known.model_copy(update={"calibration": one})))
        for one in (replace(known.calibration, linearity=error) for error in (0.0, None, 0.1))
    )
    assert np.array_equal(declared.B, unknown.B)
    assert (unknown.B_se > declared.B_se).all()
    assert (poor.B_se > 2.0 * declared.B_se).all()


def test_torques_that_a_load_keeps_of_one_sign_are_no_fault(
    recording: armimp.Recording, result: armimp.Result
) -> None:
    loaded = tuple(replace(one, torque=one.torque + 15.0) for one in recording.trials)
    found = armimp.identify(replace(recording, trials=loaded))
    assert found.valid, found.problems
    assert (np.abs(found.K - result.K) < 0.1 * result.K_se).all()


def test_a_transducer_that_shows_the_torque_of_another_joint_is_named_with_its_share() -> None:
    sensors = {"sensors.torque.cross_talk": 0.05, "substeps": 20}
    crossed = armimp.simulate(duration=20.0, friction=0, resolution=0, arm_sim=sensors)
    found = armimp.identify(crossed)
    assert not found.impedance_valid
    # A gain error of the shoulder would explain its share as well: this arm's rows are alike.
    assert any(
        re.match(r"the transducer of elbow shows 4\.\d+ ± 0\.\d+ % of the torque of shoulder", one)
        for one in found.problems
    ), found.problems


def test_an_undeclared_delay_of_the_torques_is_not_taken_for_a_nonlinear_arm() -> None:
    sensors = {"sensors.torque.delay": 0.0015, "substeps": 20}
    late = armimp.simulate(duration=20.0, arm_sim=sensors)
    command = [one.command for one in late.trials]
    found = armimp.identify(rebuilt(late, command=command, calibration=late.known.calibration))
    assert found.valid, found.problems
    assert any("late against angles by 1.5" in one for one in found.notes), found.notes
    assert not any("amplitude" in one or "hysteresis" in one for one in found.notes)


def test_bands_of_an_impedance_behind_an_unknown_filter_allow_for_it() -> None:
    free = armimp.simulate(duration=20.0, friction=0, arm_sim={"substeps": 20})
    assert free.truth is not None
    low_pass = butter(4, 15.0, fs=1000.0, output="sos")
    known = {"timing": "before_update", "calibration": armimp.Calibration()}
    known["command"] = [one.command for one in free.trials]
    behind = [sosfilt(low_pass, one.torque) for one in free.trials]
    found = armimp.identify(rebuilt(free, torque=behind, **known))
    off = np.abs(found.Z - free.truth.impedance(found.f)) ** 2
    assert found.impedance_valid
    assert not found.valid
    assert np.mean(off > 3.0 * found.Z_variance) < 0.05
    assert sum("of the torque of joint_" in one for one in found.notes) == 2, found.notes
    without = armimp.identify(rebuilt(free, **known))
    assert (without.Z_variance < 0.01 * found.Z_variance).mean() > 0.9


def test_rounding_that_repeats_with_each_short_period_is_in_the_standard_errors() -> None:
    push = 4.0 * np.sign(np.arange(500) - 249.5)
    s = 2000j * np.pi * np.fft.rfftfreq(500)
    arm = 0.1 * s**2 + 0.5 * s + 8.0
    moved = np.fft.rfft(push) / (arm + 0.2 * s**2 + 0.4 * s)
    angle, torque = (np.tile(np.fft.irfft(one), 60) for one in (moved, arm * moved))
    noise = 1e-3 * np.random.default_rng(1).standard_normal(torque.size)
    found = armimp.identify(
        armimp.Recording.from_arrays(
            [np.tile(push, 60)[None]],
            [np.round(angle / 2e-4)[None] * 2e-4],
            [(torque + noise)[None]],
            rate=1000.0,
            timing="simultaneous",
            calibration=armimp.Calibration(),
        )
    )
    assert found.valid, found.problems
    for letter, true in (("M", 0.1), ("B", 0.5), ("K", 8.0)):
        value, error = getattr(found, letter), getattr(found, f"{letter}_se")
        assert abs(value - true) < 3.0 * error


def test_torques_that_another_clock_times_are_found_and_valid(
    recording: armimp.Recording,
) -> None:
    samples = np.arange(recording.trials[0].samples)
    later = [
        np.stack([np.interp((1.0 - 1e-4) * samples, samples, row) for row in one.torque])
        for one in recording.trials
    ]
    found = armimp.identify(rebuilt(recording, torque=later))
    assert found.valid, found.problems
    by = [
        re.search(r"another clock than its angle: it gets later by (\S+) ±", one)
        for one in found.notes
    ]
    assert [float(one[1]) for one in by if one] == pytest.approx([2.0, 2.0], rel=0.1)


def test_a_constant_in_the_perturbation_of_all_joints_perturbs_none(
    recording: armimp.Recording, result: armimp.Result
) -> None:
    offset = [one.perturbation + 0.05 for one in recording.trials]
    found = armimp.identify(rebuilt(recording, perturbation=offset))
    assert found.valid, found.problems
    np.testing.assert_allclose(found.M, result.M, rtol=0.01)


def test_sensors_that_are_declared_exact_narrow_the_intervals(recording: armimp.Recording) -> None:
    exact = armimp.identify(rebuilt(recording, calibration=armimp.Calibration()))
    assert (exact.M_se < armimp.identify(rebuilt(recording)).M_se).all()


def test_commands_that_move_nothing_confirm_no_gain(recording: armimp.Recording) -> None:
    nothing = [np.zeros_like(one.torque) for one in recording.trials]
    with_nothing, without = (
        armimp.identify(rebuilt(recording, command=command)) for command in (nothing, None)
    )
    for found in (with_nothing, without):
        assert sum("no command confirms the gain" in one for one in found.notes) == 2
    np.testing.assert_allclose(with_nothing.K_se, without.K_se, rtol=0.05)


@pytest.mark.parametrize("joints", [pytest.param(1, marks=pytest.mark.slow), 2])
def test_commands_that_are_the_perturbations_are_said_to_explain_no_torque(joints: int) -> None:
    recording = armimp.simulate(joints=joints, duration=10.0, seed=1)
    command = [one.perturbation for one in recording.trials]
    found = armimp.identify(rebuilt(recording, command=command))
    told = found.problems + found.notes
    assert any("commands don't explain the torques" in one for one in told)
    assert not any("seems to show" in one for one in told)
