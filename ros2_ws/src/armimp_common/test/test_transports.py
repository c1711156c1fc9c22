"""Between processes nothing is shared that a killed one could leave locked."""

import os
import subprocess
import sys

import pytest

NODE = """
import pathlib, sys
from rclpy.node import Node
from armimp_common.executor import run_node
class Watched(Node):
    def __init__(self, **kwargs):
        super().__init__("watched", **kwargs)
        print(pathlib.Path("/proc/self/maps").read_text())
sys.exit(run_node(Watched, until=lambda _: True))
"""


@pytest.mark.parametrize(("chosen", "shared"), [(None, False), ("UDPv4", False), ("DEFAULT", True)])
def test_a_node_shares_no_memory_unless_the_user_wants_it(
    domain_id: int, chosen: str | None, shared: bool
) -> None:
    kept = {
        name: value
        for name, value in os.environ.items()
        if name not in {"FASTRTPS_DEFAULT_PROFILES_FILE", "ROS_AUTOMATIC_DISCOVERY_RANGE"}
    }
    choice = {} if chosen is None else {"FASTDDS_BUILTIN_TRANSPORTS": chosen}

    done = subprocess.run(
        [sys.executable, "-c", NODE],
        capture_output=True,
        text=True,
        check=False,
        env=kept | choice | {"ROS_DOMAIN_ID": str(domain_id)},
    )

    assert done.returncode == 0, done.stderr
    assert "libfastrtps" in done.stdout
    assert ("/dev/shm/fastrtps" in done.stdout) == shared
