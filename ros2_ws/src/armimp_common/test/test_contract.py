"""The topic contract is complete, and can be used without ROS."""

import subprocess
import sys

import pytest

from armimp_common import contract


def test_every_topic_has_a_message_type() -> None:
    topics = {
        value
        for name, value in vars(contract).items()
        if name.isupper() and isinstance(value, str) and not name.endswith(("_NODE", "_SERVICE"))
    }

    assert topics == set(contract.MESSAGE_TYPES)


def test_every_joint_state_topic_has_a_value_field() -> None:
    joint_states = {
        topic for topic, kind in contract.MESSAGE_TYPES.items() if kind.endswith("/JointState")
    }

    assert joint_states == set(contract.VALUE_FIELD)


def test_data_topics_are_relative_and_shared_ones_absolute() -> None:
    absolute = {topic for topic in contract.MESSAGE_TYPES if topic.startswith("/")}

    assert absolute == {"/clock", "/diagnostics"}


@pytest.mark.parametrize(
    "module",
    [
        "armimp_common",
        "armimp_common.cdr",
        "armimp_common.contract",
        "armimp_common.diagnostics",
        "armimp_common.domain",
        "armimp_common.errors",
        "armimp_common.schema",
        "armimp_common.trial_status",
        "armimp_common.versions",
    ],
)
def test_module_imports_neither_rclpy_nor_messages(module: str) -> None:
    script = (
        f"import sys, {module}\n"
        "found = [m for m in sys.modules if m.partition('.')[0].endswith(('rclpy', '_msgs'))]\n"
        "sys.exit(', '.join(found) or 0)"
    )

    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False
    )

    assert done.returncode == 0, done.stderr
