"""The mock of the device: raw counts of the simulated rig, and the faults of a bus."""

import math
from typing import Any

import numpy as np
import pytest

from armimp_common.realtime import Pacer
from armimp_driver_template.conversion import Drives, Encoders, Sensors, Wiring
from armimp_driver_template.device import Frame
from armimp_driver_template.mock import MockDevice
from armimp_driver_template.parameters import (
    DriveParameters,
    DriverParameters,
    MockParameters,
    SensorParameters,
)
from armimp_sim.parameters import SimulatorParameters
from armimp_sim.simulator import SimulatedRig
from support import known


def make(mode: str = "lockstep", **options: Any) -> MockDevice:
    return mock(DriverParameters.model_validate({"mode": mode, "mock": MockParameters(**options)}))


def mock(parameters: DriverParameters) -> MockDevice:
    instant = Pacer(now=lambda: 0, sleep=lambda _: None)
    instant.wait = lambda tick: None  # type: ignore[method-assign]
    return MockDevice(parameters, instant)


def commands(count: int) -> list[tuple[float, float]]:
    return [(a, b) for a, b in np.random.default_rng(3).uniform(-20, 20, (count, 2)).tolist()]


def answers(device: MockDevice, script: list[tuple[float, float]]) -> list[Frame | None]:
    frames = [device.receive(0.1)]
    for torque in script:
        device.send(torque)
        frames.append(device.receive(0.1))
    return frames


def test_converted_counts_are_the_readings_of_the_simulated_rig_to_the_last_bit() -> None:
    parameters = DriverParameters()
    encoders = Encoders("encoder", parameters.encoder, 2)
    transducers = Sensors("transducer", parameters.transducer, 2)
    rig, script = SimulatedRig(SimulatorParameters.preset()), commands(300)

    for number, frame in enumerate(map(known, answers(make(), script))):
        assert frame.counter == number
        assert encoders.angles(frame.encoder) == tuple(rig.position.tolist())
        assert transducers.values(frame.transducer) == tuple(rig.torque.tolist())
        if number < len(script):
            rig.step(script[number])


def test_with_latency_commands_act_so_many_periods_later() -> None:
    script = commands(100)
    prompt, late = answers(make(), script), answers(make(latency=3), [*script, *commands(3)])
    readings = [[frame and frame.encoder for frame in frames] for frames in (prompt, late)]
    assert readings[1][3 : 3 + len(script)] == readings[0][: len(script)]


def test_lost_frames_leave_a_gap_in_the_counter() -> None:
    device = make("realtime", dropout=0.2)
    frames = [device.receive(0.1) for _ in range(2000)]
    counters = [frame.counter for frame in frames if frame is not None]
    assert 1500 < len(counters) < 1700
    assert [i for i, frame in enumerate(frames) if frame is not None] == counters


def test_readings_and_commands_survive_any_wiring_signs_and_gears() -> None:
    """The device has its joints the other way round, turns backwards, and has gears."""
    plain = DriverParameters(mode="lockstep")
    twisted = DriverParameters(
        mode="lockstep",
        device_names=("m2", "m1"),
        encoder=SensorParameters(
            resolution=(2.0 * math.pi / 51200,), zero=(7, 60000), sign=(-1, 1), gear=(1.0, 1.0)
        ),
        transducer=SensorParameters(resolution=(0.01,), zero=(5,), sign=(1, -1), gear=(0.5,)),
        drive=DriveParameters(sign=(-1, 1), gear=(50.0, 0.25)),
        mock=MockParameters(names=("m2", "m1")),
    )
    seen = []
    for parameters in (plain, twisted):
        device, drives = mock(parameters), Drives(parameters.drive, 2)
        wiring = Wiring(device.names, parameters.names_at_device())
        encoders = Encoders("encoder", parameters.encoder, 2)
        transducers = Sensors("transducer", parameters.transducer, 2)
        found = []
        for torque in [(0.0, 0.0), *commands(200)]:
            frame = known(device.receive(0.1))
            angles = encoders.angles(wiring.to_joints(frame.encoder))
            found.append((*angles, *transducers.values(wiring.to_joints(frame.transducer))))
            device.send(wiring.to_device(drives.of_drives(torque)))
        seen.append(np.array(found))
    assert seen[1] == pytest.approx(seen[0], abs=1e-9)
