"""What the container files name is there: no engine is needed to see that."""

import os
import re
from typing import Any

import pytest
import yaml

from armimp_common.topics import CONTROLLER_NODE, ESTIMATOR_NODE, SIM_NODE
from support.places import ROOT

DOCKER = ROOT / "docker"
DOCKERFILES = ("Dockerfile", "ros.Dockerfile")
INSIDE = "/opt/armimp/src/"
"""Where the project is in an image."""


def instructions(name: str) -> list[tuple[str, str]]:
    """Return instructions and their arguments, continued lines joined."""
    text = (DOCKER / name).read_text(encoding="utf-8").replace("\\\n", " ")
    lines = [line for line in text.splitlines() if line and not line.startswith("#")]
    return [(line.split()[0], line.split(maxsplit=1)[1]) for line in lines]


SERVICES: dict[str, Any] = yaml.safe_load((DOCKER / "compose.yaml").read_text("utf-8"))["services"]
NODES = {name: service for name, service in SERVICES.items() if name != "armimp"}


@pytest.mark.parametrize("name", DOCKERFILES)
def test_images_copy_and_run_what_is_there_and_end_as_an_ordinary_user(name: str) -> None:
    found = instructions(name)
    for instruction, arguments in found:
        words = [word for word in arguments.split() if not word.startswith("--")]
        if instruction == "COPY":
            assert all((ROOT / source).exists() for source in words[:-1])
        if instruction == "RUN" and words[0].startswith("docker/"):
            assert os.access(ROOT / words[0], os.X_OK)
    users = [arguments for instruction, arguments in found if instruction == "USER"]
    assert users[-1] == "10001"
    (created,) = re.findall(r"useradd --create-home --uid (\d+) armimp", str(found))
    assert created == users[-1]


def test_every_node_has_a_container_with_its_parameters() -> None:
    assert sorted(NODES) == sorted((SIM_NODE, CONTROLLER_NODE, ESTIMATOR_NODE))
    for name, service in NODES.items():
        executable, *_, parameters = service["command"]
        assert executable == name
        assert parameters.startswith(INSIDE)
        assert (ROOT / parameters.removeprefix(INSIDE)).name == f"{name}.yaml"
        assert (ROOT / parameters.removeprefix(INSIDE)).is_file()
