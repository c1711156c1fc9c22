"""Precedence over other work of the machine, where that is permitted."""

from armimp_common.errors import ConfigurationError
from armimp_common.realtime import require_precedence

PRIORITY = 30


def permitted_priority() -> int:
    """Return a SCHED_FIFO priority if this user may have one, else 0."""
    try:
        require_precedence(PRIORITY)
    except ConfigurationError:
        return 0
    return PRIORITY
