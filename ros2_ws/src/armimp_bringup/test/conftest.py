"""Fixtures of all tests of this package."""

from armimp_common.testing import interruptible

__all__ = ["interruptible"]
