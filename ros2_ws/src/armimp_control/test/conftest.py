"""Fixtures of all tests of this package."""

from armimp_common.fault_figures import figures, pytest_terminal_summary
from armimp_common.testing import context, domain_id, node

__all__ = ["context", "domain_id", "figures", "node", "pytest_terminal_summary"]
