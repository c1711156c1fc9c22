"""Fixtures of all tests of this package."""

from support.graph import context, domain_id, node

__all__ = ["context", "domain_id", "node"]
