"""Message definitions and type hashes of the recorded topics, as rosbag2 stores them."""

from dataclasses import dataclass
from functools import cache


@dataclass(frozen=True, kw_only=True)
class MessageDefinition:
    """What a bag says about a message type.

    Parameters
    ----------
    type : str
        Full name, e.g. ``sensor_msgs/msg/JointState``.
    text : str
        The definition followed by those of all types it is made of (encoding ``ros2msg``).
    type_hash : str
        RIHS01 hash of the type description, by which ROS 2 compares types.
    """

    type: str
    text: str
    type_hash: str


@cache
def message_definition(type_name: str) -> MessageDefinition:
    """Definition of a message type of ROS 2 Jazzy.

    Parameters
    ----------
    type_name : str
        Full name, e.g. ``sensor_msgs/msg/JointState``.

    Raises
    ------
    KeyError
        If the type is not part of the standard messages.
    """
    # Reading needs no definitions, and no time for loading them.
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    text, _ = store.generate_msgdef(type_name, ros_version=2)
    return MessageDefinition(type=type_name, text=text, type_hash=store.hash_rihs01(type_name))
