"""One error class for each role, so that callers can tell a wrong usage from bad data.

``str(error)`` is always a single line meant for the user, with the offending value in it.
"""


class ArmimpError(Exception):
    """Base of every error that armimp raises on purpose.

    Parameters
    ----------
    message
        One line.
    code
        Kind of problem that it makes of a result, if another than its class tells.
    """

    def __init__(self, message: str, code: str = "") -> None:
        super().__init__(message)
        self.code = code


class ConfigurationError(ArmimpError):
    """A wrong usage or a wrong parameter value (exit status 2)."""


class MalformedMessageError(ArmimpError):
    """Bytes or key-values which are not the message that they claim to be."""


class BagError(ArmimpError):
    """A bag that is unreadable or incomplete; the message names the file (exit status 1)."""


class DataError(ArmimpError):
    """A record that cannot be estimated: gaps, too short, not finite (exit status 1)."""


class GraphError(ArmimpError):
    """The node graph failed: discovery, a lifecycle transition, a dead node (exit status 1)."""


class InterruptionError(ArmimpError):
    """The user ended the work before it was done; says what is left of it (exit status 130)."""
