"""Fixtures of all tests of this package."""

from support.fault_figures import figures, pytest_terminal_summary
from support.graph import context, domain_id, node

__all__ = ["context", "domain_id", "figures", "node", "pytest_terminal_summary"]
