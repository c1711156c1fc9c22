"""The architecture page: its names exist, and its decisions have dates."""

import importlib.util
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

from armimp_common.topics import (
    CONTROLLER_NODE,
    DATA_STREAMS,
    ESTIMATOR_NODE,
    RECEIVED,
    SIM_NODE,
    TRIAL,
)

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
PICTURE = ROOT / "docs" / "images" / "architecture.svg"


@pytest.mark.parametrize("name", sorted(set(re.findall(r"`(armimp_\w+(?:\.\w+)+)`", PAGE))))
def test_every_module_that_the_page_names_exists(name: str) -> None:
    assert importlib.util.find_spec(name) is not None


def test_every_decision_has_a_date() -> None:
    part = PAGE.partition("\n## 6. Decisions")[2].partition("\n## 7. ")[0]
    decisions = re.split(r"^\d+\. ", part, flags=re.MULTILINE)[1:]
    assert len(decisions) > 20
    assert [one for one in decisions if not re.search(r"20\d\d-\d\d-\d\d\)", one)] == []


def test_the_picture_shows_topics_and_nodes_that_exist() -> None:
    texts = [
        one.text or "" for one in ElementTree.parse(PICTURE).iter() if one.tag.endswith("text")
    ]
    # A topic may be broken over two lines, or be followed by words.
    shown = re.sub(r"/\n", "/", "\n".join(texts))
    found = re.findall(r"^(\w+/[a-z]+|joint_states, torque_sensors|\w+_\w+s)(?=:|$)", shown, re.M)
    topics = {topic for one in found for topic in one.split(", ")}
    assert topics == {*DATA_STREAMS, TRIAL, RECEIVED}
    for node in (SIM_NODE, CONTROLLER_NODE, ESTIMATOR_NODE):
        assert node in texts
