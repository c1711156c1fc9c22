"""What the armimp packages share: message contract, wire format, errors; no physics, no ROS.

The modules that need rclpy (``qos``, ``executor``, ``parameters``, ``pubsub``, ``lifecycle``)
are imported by name and never from here, so that the mathematics can be used without ROS.
"""

from armimp_common.errors import (
    ArmimpError,
    BagError,
    ConfigurationError,
    DataError,
    GraphError,
    MalformedMessageError,
)
from armimp_common.trial_status import Phase, TrialStatus

__all__ = [
    "ArmimpError",
    "BagError",
    "ConfigurationError",
    "DataError",
    "GraphError",
    "MalformedMessageError",
    "Phase",
    "TrialStatus",
]
