"""Names, types and rates of everything that nodes, bags and drivers exchange.

Topic names without a leading slash are relative, so namespaces and remapping apply to them.
"""

from collections.abc import Mapping
from typing import Final, Literal, NamedTuple

ValueField = Literal["position", "effort"]
"""The array of a ``sensor_msgs/JointState`` in which a stream carries its numbers."""

NS_PER_S: Final = 1_000_000_000
PERIOD_NS: Final = 1_000_000
"""Control and acquisition period (ns)."""
PERIOD: Final = PERIOD_NS / NS_PER_S
"""Control and acquisition period (s)."""
RATE: Final = NS_PER_S / PERIOD_NS
"""Samples per second (Hz)."""

SIM_NODE: Final = "arm_sim"
CONTROLLER_NODE: Final = "imbic_controller"
ESTIMATOR_NODE: Final = "impedance_estimator"
SUPERVISOR_NODE: Final = "armimp"

CONTROLLER_STOP_SERVICE: Final = "imbic_controller/emergency_stop"
CONTROLLER_RESET_SERVICE: Final = "imbic_controller/reset"
SIM_STOP_SERVICE: Final = "arm_sim/emergency_stop"
SIM_RESET_SERVICE: Final = "arm_sim/reset"

JOINT_STATES: Final = "joint_states"
TORQUE_SENSORS: Final = "torque_sensors"
COMMANDS: Final = "effort_controller/commands"
PERTURBATION: Final = "imbic_controller/perturbation"
TRIAL: Final = "imbic_controller/trial"
PROGRESS: Final = "impedance_estimator/progress"
RESULT: Final = "impedance_estimator/result"
RECEIVED: Final = "impedance_estimator/received"
STOPPING: Final = "impedance_estimator/stopping"
CLOCK: Final = "/clock"
DIAGNOSTICS: Final = "/diagnostics"


class Qos(NamedTuple):
    """Quality of service of a topic, with the names that rosbag2 has for it."""

    depth: int
    """Messages that are queued until they are taken."""
    reliability: Literal["reliable", "best_effort"] = "reliable"
    durability: Literal["volatile", "transient_local"] = "volatile"


class Topic(NamedTuple):
    """What a topic carries, and how."""

    type: str
    """Name of the message type."""
    qos: Qos
    field: ValueField | None = None
    """Where a JointState stream carries its numbers: encoder angle (rad) or torque (N·m)."""


_SAMPLE: Final = Qos(2000)
"""Two seconds of depth, since a process that stalls must not lose samples."""
_LATCHED: Final = Qos(10, durability="transient_local")
"""Whoever joins late must still learn the last ones."""

TOPICS: Final[Mapping[str, Topic]] = {
    JOINT_STATES: Topic("sensor_msgs/msg/JointState", _SAMPLE, "position"),
    TORQUE_SENSORS: Topic("sensor_msgs/msg/JointState", _SAMPLE, "effort"),
    COMMANDS: Topic("std_msgs/msg/Float64MultiArray", _SAMPLE),
    PERTURBATION: Topic("sensor_msgs/msg/JointState", _SAMPLE, "effort"),
    TRIAL: Topic("diagnostic_msgs/msg/DiagnosticStatus", _LATCHED),
    # For display only: nobody needs the old ones.
    PROGRESS: Topic("diagnostic_msgs/msg/DiagnosticStatus", Qos(10)),
    RESULT: Topic("diagnostic_msgs/msg/DiagnosticStatus", _LATCHED),
    RECEIVED: Topic("std_msgs/msg/UInt64", _LATCHED),
    STOPPING: Topic("diagnostic_msgs/msg/DiagnosticStatus", _LATCHED),
    # Only the newest counts, and no subscriber may hold the simulator up.
    CLOCK: Topic("rosgraph_msgs/msg/Clock", Qos(1, "best_effort")),
    DIAGNOSTICS: Topic("diagnostic_msgs/msg/DiagnosticArray", Qos(10)),  # as aggregators expect
}
"""Every topic but the heartbeats, see :mod:`armimp_common.qos`."""

DATA_STREAMS: Final = (JOINT_STATES, TORQUE_SENSORS, COMMANDS, PERTURBATION)
"""The topics with one message in every control period."""

RECORDED: Final = (*DATA_STREAMS, TRIAL, CLOCK, DIAGNOSTICS)
"""The topics that are recorded in bags."""

VALUE_FIELD: Final = {name: topic.field for name, topic in TOPICS.items() if topic.field}
"""The array of each JointState stream that carries its numbers."""

RECORDER_GONE: Final = 2**64 - 1
"""On ``impedance_estimator/received``: recording has ended, so nobody has to wait for it."""

RECEIVED_EVERY: Final = 10
"""Number of samples between two reports of the recorder on how many it has received."""


def alive(node: str) -> str:
    """Return the topic of the heartbeat of a node."""
    return f"{node}/alive"


def clock_step(before_ns: int, stamp_ns: int) -> str:
    """Return a sentence if the clock of the stamps was set between two samples, else "".

    Only steps of at least a second count: if samples stay away that long, the trial ends anyway.

    Parameters
    ----------
    before_ns, stamp_ns : stamps of two samples, one after the other (ns)
    """
    ahead_ns = stamp_ns - before_ns
    if abs(ahead_ns) < NS_PER_S:
        return ""
    return (
        f"stamps jump by {ahead_ns / NS_PER_S:+.6g} s, from {before_ns} ns to {stamp_ns} ns:"
        " the clock of the rig was set, or started anew"
    )
