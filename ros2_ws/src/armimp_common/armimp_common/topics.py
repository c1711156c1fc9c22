"""Names, types and rates of everything that nodes, bags and drivers exchange.

Topic names without a leading slash are relative, so namespaces and remapping apply to them.
"""

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

MESSAGE_TYPES: Final[dict[str, str]] = {
    JOINT_STATES: "sensor_msgs/msg/JointState",
    TORQUE_SENSORS: "sensor_msgs/msg/JointState",
    COMMANDS: "std_msgs/msg/Float64MultiArray",
    PERTURBATION: "sensor_msgs/msg/JointState",
    TRIAL: "diagnostic_msgs/msg/DiagnosticStatus",
    PROGRESS: "diagnostic_msgs/msg/DiagnosticStatus",
    RESULT: "diagnostic_msgs/msg/DiagnosticStatus",
    RECEIVED: "std_msgs/msg/UInt64",
    STOPPING: "diagnostic_msgs/msg/DiagnosticStatus",
    CLOCK: "rosgraph_msgs/msg/Clock",
    DIAGNOSTICS: "diagnostic_msgs/msg/DiagnosticArray",
}

DATA_STREAMS: Final = (JOINT_STATES, TORQUE_SENSORS, COMMANDS, PERTURBATION)
"""The topics with one message in every control period."""


class Qos(NamedTuple):
    """Quality of service of a topic, with the names that rosbag2 has for it."""

    depth: int
    """Messages that are queued until they are taken."""
    reliability: Literal["reliable", "best_effort"] = "reliable"
    durability: Literal["volatile", "transient_local"] = "volatile"


SAMPLE_QOS: Final = Qos(2000)
"""Data streams: two seconds of depth, since a process that stalls must not lose samples."""
LATCHED_QOS: Final = Qos(10, durability="transient_local")
"""Trial status and results: whoever joins late must still learn the last ones."""

QOS: Final[dict[str, Qos]] = {
    **dict.fromkeys(DATA_STREAMS, SAMPLE_QOS),
    **dict.fromkeys((TRIAL, RESULT, RECEIVED, STOPPING), LATCHED_QOS),
    PROGRESS: Qos(10),  # for display only: nobody needs the old ones
    CLOCK: Qos(1, "best_effort"),  # only the newest counts; no subscriber may hold the simulator up
    DIAGNOSTICS: Qos(10),  # what diagnostic aggregators expect
}
"""Quality of service of every topic but the heartbeats, see :mod:`armimp_common.qos`."""

VALUE_FIELD: Final[dict[str, ValueField]] = {
    JOINT_STATES: "position",
    TORQUE_SENSORS: "effort",
    PERTURBATION: "effort",
}
"""Where each JointState stream carries its numbers: encoder angle (rad) or torque (N·m)."""

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
