"""The layouts for PlotJuggler and Foxglove show what the interface contract says there is."""

import importlib
import json
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest

from armimp_common.topics import DATA_STREAMS, MESSAGE_TYPES, VALUE_FIELD
from armimp_sim.presets import JOINT_NAMES

LAYOUTS = Path(__file__).resolve().parents[1] / "ros2_ws/src/armimp_bringup/layouts"
JOINTS = JOINT_NAMES[2]


def message_class(topic: str) -> Any:
    package, _, name = MESSAGE_TYPES[topic].split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def curves() -> list[str]:
    root = ET.parse(LAYOUTS / "plotjuggler.xml").getroot()
    return [curve.attrib["name"] for curve in root.iter("curve")]


def foxglove_paths() -> list[str]:
    layout = json.loads((LAYOUTS / "foxglove.json").read_text(encoding="utf-8"))
    panels = layout["configById"].values()
    plotted = [path["value"] for panel in panels for path in panel.get("paths", [])]
    return plotted + [panel["topicPath"] for panel in panels if "topicPath" in panel]


@pytest.mark.parametrize("curve", curves())
def test_every_curve_of_plotjuggler_is_one_of_the_contract(curve: str) -> None:
    # PlotJuggler names values of a JointState by joint, others by field.
    topic = next(topic for topic in MESSAGE_TYPES if curve.startswith(f"/{topic}/"))
    rest = curve.removeprefix(f"/{topic}/")
    if topic in VALUE_FIELD:
        assert rest.split("/") in [[joint, VALUE_FIELD[topic]] for joint in JOINTS]
    else:
        field = re.fullmatch(r"(\w+)\[([01])\]", rest)
        assert field is not None
        kind = message_class(topic).get_fields_and_field_types()[field[1]]
        assert kind == "sequence<double>"


@pytest.mark.parametrize("path", foxglove_paths())
def test_every_path_of_foxglove_is_one_of_the_contract(path: str) -> None:
    parsed = re.fullmatch(r"/([\w/]+)(?:\.(\w+)\[([01]|:)\])?", path)
    assert parsed is not None
    topic = parsed[1] if parsed[1] in MESSAGE_TYPES else f"/{parsed[1]}"
    fields = message_class(topic).get_fields_and_field_types()
    if parsed[2] is not None:
        assert fields[parsed[2]].startswith("sequence<")
        assert VALUE_FIELD.get(topic, parsed[2]) == parsed[2]


def test_both_show_every_data_stream_of_every_joint() -> None:
    for topic in DATA_STREAMS:
        assert len({name for name in curves() if name.startswith(f"/{topic}/")}) == len(JOINTS)
        assert len({path for path in foxglove_paths() if path.startswith(f"/{topic}.")}) == 2
