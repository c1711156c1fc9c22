"""The layouts for PlotJuggler and Foxglove show what the interface contract says there is."""

import json
import re
from xml.etree import ElementTree as ET

from armimp_common.topics import DATA_STREAMS, TOPICS, VALUE_FIELD
from armimp_sim.presets import JOINT_NAMES
from support.places import SOURCES

LAYOUTS = SOURCES["armimp_bringup"] / "layouts"
JOINTS = JOINT_NAMES[2]


def test_plotjuggler_shows_every_data_stream_of_every_joint_and_nothing_else() -> None:
    root = ET.parse(LAYOUTS / "plotjuggler.xml").getroot()
    # PlotJuggler names values of a JointState by joint, others by field.
    expected = {
        f"/{topic}/{joint}/{VALUE_FIELD[topic]}" if topic in VALUE_FIELD else f"/{topic}/data[{k}]"
        for topic in DATA_STREAMS
        for k, joint in enumerate(JOINTS)
    }
    assert {curve.attrib["name"] for curve in root.iter("curve")} == expected


def test_foxglove_shows_every_data_stream_of_every_joint_and_topics_that_there_are() -> None:
    layout = json.loads((LAYOUTS / "foxglove.json").read_text(encoding="utf-8"))
    panels = layout["configById"].values()
    plotted = [path["value"] for panel in panels for path in panel.get("paths", [])]
    assert {path for path in plotted if ":" not in path} == {
        f"/{topic}.{VALUE_FIELD.get(topic, 'data')}[{k}]" for topic in DATA_STREAMS for k in (0, 1)
    }
    shown = [panel["topicPath"] for panel in panels if "topicPath" in panel]
    topics = {re.sub(r"^/|\..*", "", path) for path in (*plotted, *shown)}
    assert topics <= {topic.removeprefix("/") for topic in TOPICS}
