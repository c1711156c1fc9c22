"""Fixtures of all tests of this package."""

from armimp_common.testing import context, domain_id, node

__all__ = ["context", "domain_id", "node"]
