"""Tells the tests that need the machine for themselves from those that can run side by side."""

import pytest

_GRAPH_FIXTURES = {"context", "domain_id", "environment"}


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark each test that starts a graph or whole programs, whose timing others would spoil."""
    programs = config.rootpath / "tests"
    for item in items:
        fixtures = set(getattr(item, "fixturenames", ()))
        if fixtures & _GRAPH_FIXTURES or programs in item.path.parents:
            item.add_marker("graph")
