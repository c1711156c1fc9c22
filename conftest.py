"""What all tests share; those of the whole have more in ``tests/conftest.py``."""

import armimp_bringup  # noqa: F401 (numpy has as many threads as in the program)

pytest_plugins = ["support.graph", "support.fault_figures"]
