"""How the middleware carries messages between the processes of one machine."""

import os
from typing import Final

_VARIABLE: Final = "FASTDDS_BUILTIN_TRANSPORTS"


def avoid_shared_memory() -> None:
    """Have Fast DDS carry messages by UDP, to be called before the first context.

    A process that is killed while it holds a lock in shared memory holds up whatever the others
    publish until they give that lock up, after a second each. A variable or a profile that the
    user has set takes precedence, and so do the transports that ROS itself sets for
    ``ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST``.
    """
    os.environ.setdefault(_VARIABLE, "UDPv4")
