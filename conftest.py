"""Tells the tests that need the machine for themselves from those that can run side by side."""

import pytest

_GRAPH_FIXTURES = {"context", "domain_id", "environment"}


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark each test that starts a graph, whose timing others would spoil.

    Where that is not to be seen from its fixtures, as with programs of their own, the file says so.
    """
    for item in items:
        if _GRAPH_FIXTURES & set(getattr(item, "fixturenames", ())):
            item.add_marker("graph")
