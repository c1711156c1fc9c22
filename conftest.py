"""What all tests share; those of the whole have more in ``tests/conftest.py``."""

pytest_plugins = ["support.graph", "support.fault_figures"]
