"""Write the default parameter files of the nodes from their schemas: config/<node>.yaml."""

from __future__ import annotations

from pathlib import Path

from armimp_bringup.config import ExperimentConfig, node_parameters
from armimp_common.schema import to_params_yaml
from armimp_common.topics import CONTROLLER_NODE, ESTIMATOR_NODE, SIM_NODE
from armimp_estimation.parameters import EstimatorParameters
from armimp_ros2_control.parameters import BridgeParameters

_HEAD = "# Parameters of the default experiment; written by scripts/write_default_configs.py.\n"
_BRIDGE_HEAD = "# Defaults of the bridge; written by scripts/write_default_configs.py.\n"
_PACKAGES = {
    SIM_NODE: "armimp_sim",
    CONTROLLER_NODE: "armimp_control",
    ESTIMATOR_NODE: "armimp_estimation",
}


def default_configs() -> dict[str, str]:
    """Text of each file by its path below ``ros2_ws/src``."""
    # The metadata and the directory of a run have no place in a default.
    models = {
        **node_parameters(ExperimentConfig(), None).by_node(),
        ESTIMATOR_NODE: EstimatorParameters(),
    }
    files = {
        f"{_PACKAGES[node]}/config/{node}.yaml": _HEAD + to_params_yaml({node: model})
        for node, model in models.items()
    }
    # It takes the place of the simulator, and so has its name.
    bridge = to_params_yaml({SIM_NODE: BridgeParameters()})
    return {**files, "armimp_ros2_control/config/ros2_control_bridge.yaml": _BRIDGE_HEAD + bridge}


def main() -> None:
    """Write the files."""
    sources = Path(__file__).resolve().parents[1] / "ros2_ws" / "src"
    for name, text in default_configs().items():
        path = sources / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
