"""The context of a graph: a domain of its own, and an environment that is given back."""

import os

import pytest

from armimp_bringup.graph import GraphContext

VARIABLES = ("ROS_AUTOMATIC_DISCOVERY_RANGE", "FASTRTPS_DEFAULT_PROFILES_FILE", "ROS_DOMAIN_ID")


@pytest.mark.parametrize("value", [None, "77"])
def test_the_environment_is_as_it_was_after_the_context(
    monkeypatch: pytest.MonkeyPatch, value: str | None
) -> None:
    for name in VARIABLES:
        monkeypatch.delenv(name, raising=False)
    if value is not None:
        monkeypatch.setenv("ROS_DOMAIN_ID", value)
    before = dict(os.environ)

    with GraphContext() as graph:
        assert os.environ["ROS_DOMAIN_ID"] == str(graph.claim.domain_id)
        assert os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
        assert os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"].endswith("fastdds.xml")

    assert dict(os.environ) == before


def test_when_the_user_chose_the_range_of_discovery_expect_it_kept(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF")

    with GraphContext():
        assert os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "OFF"

    assert os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "OFF"
