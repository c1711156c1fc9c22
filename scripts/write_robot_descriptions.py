"""Write the robot descriptions of the preset rigs: ``urdf/armimp_<n>_joints.urdf``."""

from __future__ import annotations

from pathlib import Path

from armimp_sim.description import robot_description
from armimp_sim.presets import JOINT_NAMES


def robot_descriptions() -> dict[str, str]:
    """Text of each file by its path below ``ros2_ws/src``."""
    return {
        f"armimp_sim/urdf/armimp_{joints}_joints.urdf": robot_description(joints)
        for joints in JOINT_NAMES
    }


def main() -> None:
    """Write the files."""
    sources = Path(__file__).resolve().parents[1] / "ros2_ws" / "src"
    for name, text in robot_descriptions().items():
        path = sources / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
