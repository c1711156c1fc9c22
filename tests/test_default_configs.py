"""The parameter files that come with the packages are those of the default experiment."""

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

from armimp_bringup.config import ExperimentConfig, load_config, node_parameters
from armimp_bringup.resources import config_file

ROOT = Path(__file__).resolve().parents[1]


def _script() -> ModuleType:
    path = ROOT / "scripts" / "write_default_configs.py"
    spec = importlib.util.spec_from_file_location("write_default_configs", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", sorted(_script().default_configs()))
def test_the_default_parameter_file_of_every_node_is_what_its_schema_says(name: str) -> None:
    expected: str = _script().default_configs()[name]
    assert (ROOT / "ros2_ws" / "src" / name).read_text(encoding="utf-8") == expected


def test_the_example_of_an_experiment_holds_the_defaults() -> None:
    example = load_config(config_file("experiment.yaml"), {})
    assert example.model_copy(update={"arm_sim": {}, "imbic_controller": {}}) == ExperimentConfig()
    example_parameters = node_parameters(example, None)
    default_parameters = node_parameters(ExperimentConfig(), None)
    assert example_parameters.simulator == default_parameters.simulator
    assert example_parameters.controller == default_parameters.controller
