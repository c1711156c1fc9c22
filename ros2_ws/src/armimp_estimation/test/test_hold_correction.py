"""Skew of torques that are read just before the command is updated: what it is, and its cure."""

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray

from armimp_common.errors import DataError
from armimp_estimation.estimators.lpm import LpmConfig, LpmFull
from armimp_estimation.fit import fit_mbk
from armimp_estimation.hold_correction import update_jump
from armimp_estimation.record import TrialRecord
from armimp_estimation.torque_timing import TorqueReading, TorqueTiming
from armimp_estimation.trial import TrialData
from support.held_commands import SAMPLES, TRANSMISSION, rig_record
from support.synthetic_trials import TWO_JOINT_ARM

FloatArray = NDArray[np.float64]

ARM = TWO_JOINT_ARM


@pytest.fixture(scope="module")
def chattering() -> list[TrialRecord]:
    return [rig_record(joint, chatter=1.0, count=1e-5) for joint in range(2)]


@pytest.fixture(scope="module")
def smooth() -> list[TrialRecord]:
    return [rig_record(joint, chatter=0.0) for joint in range(2)]


def viscosity(records: list[TrialRecord], config: LpmConfig | None = None) -> FloatArray:
    """Fitted viscosity relative to the true one."""
    data = [TrialData.of(record) for record in records]
    estimator = LpmFull() if config is None else LpmFull(config=config)
    return fit_mbk(estimator.estimate(data)).mbk.B / ARM.B


def test_chatter_of_the_command_tells_how_far_torques_jump(chattering: list[TrialRecord]) -> None:
    found = update_jump(chattering)
    assert found is not None
    np.testing.assert_allclose(found.torque, TRANSMISSION, atol=0.02 * np.max(TRANSMISSION))


def test_without_chatter_the_motion_tells(smooth: list[TrialRecord]) -> None:
    found = update_jump(smooth)
    assert found is not None
    np.testing.assert_allclose(found.torque, TRANSMISSION, atol=0.08 * np.max(TRANSMISSION))


@pytest.mark.parametrize("rig", ["chattering", pytest.param("smooth", marks=pytest.mark.slow)])
def test_viscosity_is_right_with_commands_and_nearly_so_without(
    rig: str, request: pytest.FixtureRequest
) -> None:
    records: list[TrialRecord] = request.getfixturevalue(rig)
    before = LpmConfig(reading=TorqueReading(timing=TorqueTiming.BEFORE_UPDATE))
    np.testing.assert_allclose(viscosity(records, before), 1.0, atol=0.005)
    without = [dataclasses.replace(record, command=None) for record in records]
    np.testing.assert_allclose(viscosity(without), 1.0, atol=0.025)
    # Where the records refute what is declared, it is not believed.
    simultaneous = LpmConfig(reading=TorqueReading(timing=TorqueTiming.SIMULTANEOUS))
    np.testing.assert_allclose(viscosity(without, simultaneous), 1.0, atol=0.025)


def test_when_commands_do_not_drive_the_torques_expect_none(chattering: list[TrialRecord]) -> None:
    noise = np.random.default_rng(1).standard_normal((2, SAMPLES))
    foreign = [dataclasses.replace(record, command=noise) for record in chattering]
    assert update_jump(foreign) is None


def test_when_commands_are_of_other_joints_or_samples_expect_none(
    chattering: list[TrialRecord],
) -> None:
    def changed(command: FloatArray) -> TrialRecord:
        return dataclasses.replace(record, command=command)

    for shift in (-1, 1):
        shifted = []
        for record in chattering:
            assert record.command is not None
            shifted.append(changed(np.roll(record.command, shift, axis=1)))
        assert update_jump(shifted) is None
    swapped = []
    for record in chattering:
        assert record.command is not None
        swapped.append(changed(record.command[::-1]))
    assert update_jump(swapped) is None


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_when_positions_are_too_large_to_be_squared_expect_data_error(
    smooth: list[TrialRecord],
) -> None:
    absurd = [dataclasses.replace(one, position=1e300 * one.position) for one in smooth]
    with pytest.raises(DataError, match="too large"):
        update_jump(absurd)
