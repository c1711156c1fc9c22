"""Parameter files, robot descriptions and tables of parameters follow from the code."""

from pathlib import Path

import pytest
from write_generated import _with_tables, generated

from armimp_bringup.config import ExperimentConfig, load_config
from armimp_bringup.parameters import node_parameters
from support.places import ROOT

GENERATED = generated()


@pytest.mark.parametrize("name", sorted(GENERATED), ids=str)
def test_every_file_is_as_write_generated_writes_it(name: Path) -> None:
    assert (ROOT / name).read_text(encoding="utf-8") == GENERATED[name]


def test_the_example_of_an_experiment_holds_the_defaults() -> None:
    example = load_config(ROOT / "ros2_ws/src/armimp_bringup/config/experiment.yaml", {})
    assert example.model_copy(update={"arm_sim": {}, "imbic_controller": {}}) == ExperimentConfig()
    example_parameters = node_parameters(example, None)
    default_parameters = node_parameters(ExperimentConfig(), None)
    assert example_parameters.simulator == default_parameters.simulator
    assert example_parameters.controller == default_parameters.controller


def test_a_section_with_another_number_of_tables_is_refused_in_words() -> None:
    for tables in (1, 3):
        with pytest.raises(SystemExit, match="2 tables under '## Keys'"):
            _with_tables("\n## Keys\n|a|\n\n|b|\n", "## Keys", ["|new|\n"] * tables)
