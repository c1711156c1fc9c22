"""The mock of the device: raw counts of the simulated rig, and the faults of a bus."""

from typing import Any

import numpy as np

from armimp_common.contract import PERIOD_NS
from armimp_common.pacing import Pacer
from armimp_driver_template.conversion import Encoders, Transducers
from armimp_driver_template.device import Frame
from armimp_driver_template.mock import MockDevice
from armimp_driver_template.parameters import DriverParameters, MockParameters
from armimp_sim.parameters import SimulatorParameters
from armimp_sim.rig import SimulatedRig


def make(mode: str = "lockstep", **options: Any) -> MockDevice:
    parameters = DriverParameters.model_validate({"mode": mode, "mock": MockParameters(**options)})
    instant = Pacer(PERIOD_NS, now=lambda: 0, sleep=lambda _: None)
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
    encoders = Encoders(parameters.encoder.resolution, parameters.encoder.zero)
    transducers = Transducers(parameters.transducer.resolution, parameters.transducer.zero)
    rig, script = SimulatedRig(SimulatorParameters.preset()), commands(300)

    for number, frame in enumerate(answers(make(), script)):
        assert frame is not None
        assert frame.counter == number
        assert encoders.angles(frame.encoder) == tuple(rig.position.tolist())
        assert transducers.torques(frame.transducer) == tuple(rig.torque.tolist())
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


def test_transducers_drift_as_told() -> None:
    device = make("realtime", drift=2.0)
    frames = [device.receive(0.1) for _ in range(1001)]
    first, last = frames[0], frames[-1]
    assert first is not None
    assert last is not None
    assert [b - a for a, b in zip(first.transducer, last.transducer, strict=True)] == [100, 100]


def test_in_lockstep_nothing_comes_without_a_command() -> None:
    device = make()
    assert device.receive(0.0) is not None
    assert device.receive(0.01) is None
