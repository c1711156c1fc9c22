"""The error of the study."""

from armimp_common.errors import ArmimpError


class StudyError(ArmimpError):
    """The study cannot be run or stored; exit status 1."""
