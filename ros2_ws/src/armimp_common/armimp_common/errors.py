"""One error class for each role, so that callers can tell wrong usage from bad data.

``str(error)`` is always a single line meant for the user, with the offending value in it.
"""


class ArmimpError(Exception):
    """Base of every error that armimp raises on purpose.

    Parameters
    ----------
    message : one line
    code : code of the problem that this error causes in a result; empty for the caller's default
    """

    def __init__(self, message: str, code: str = "") -> None:
        super().__init__(message)
        self.code = code


class ConfigurationError(ArmimpError):
    """Wrong usage or a wrong parameter value (exit status 2)."""


class MalformedMessageError(ArmimpError):
    """Bytes or key-values that are not the message they claim to be."""


class BagError(ArmimpError):
    """A bag that is unreadable or incomplete; the message names the file (exit status 1)."""


class DataError(ArmimpError):
    """A record that cannot be estimated: gaps, too short, not finite (exit status 1)."""


class GraphError(ArmimpError):
    """The node graph failed: discovery, a lifecycle transition, a dead node (exit status 1)."""


class InterruptionError(ArmimpError):
    """The user ended the work early; the message says what remains of it (exit status 130)."""
