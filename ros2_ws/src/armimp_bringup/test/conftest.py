"""Fixtures of all tests of this package."""

from support.graph import interruptible

__all__ = ["interruptible"]
