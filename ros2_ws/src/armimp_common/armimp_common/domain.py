"""Choice of a ROS domain id that no other experiment on this machine has."""

import os
import random
import socket
from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING, Final

from armimp_common.errors import ConfigurationError, GraphError

if TYPE_CHECKING:
    from typing_extensions import Self

LOWEST: Final = 1
HIGHEST: Final = 100
"""Domain ids beyond 101 collide with ephemeral ports on Linux; 0 is everybody's default."""
FAIR_SHARE: Final = HIGHEST // 2
"""A user who occupies more domains than this keeps nobody else out."""
_FIRST_PORT: Final = 7400
_PORTS: Final = 250
"""The middleware binds the ports ``7400 + 250 d`` to ``+ 249`` in domain d, but never this one:"""
_CLAIM: Final = 2


class DomainClaim:
    """A domain id held by this process until `release`, or until the process ends.

    The claim is a UDP port of the domain that the middleware leaves free, bound on the loopback
    interface. So it is exclusive between all users, leaves nothing behind after a crash, and needs
    no directory that can be written to; a lock file would belong to the user who made it first, who
    could keep all others out. A domain is chosen in which no program of this machine has
    a port. No user can keep the others out: if no domain is free, one is taken of a user who
    occupies more than `FAIR_SHARE` of them.

    Parameters
    ----------
    domain_id
        The id to claim; None takes any that is free.

    Attributes
    ----------
    domain_id : int
        The claimed id.

    Raises
    ------
    ConfigurationError
        If the given id is out of range.
    GraphError
        If the given id is taken, or none is free.
    """

    def __init__(self, domain_id: int | None = None) -> None:
        self._socket: socket.socket | None = None
        if domain_id is not None:
            if not 0 <= domain_id <= HIGHEST:
                raise ConfigurationError(f"domain id is not within 0..{HIGHEST}: {domain_id}")
            if not self._bind(domain_id):
                raise GraphError(f"domain id {domain_id} is taken by another experiment")
            return
        candidates = list(range(LOWEST, HIGHEST + 1))
        # Not the seeded generator of an experiment: two equal experiments must differ here.
        random.SystemRandom().shuffle(candidates)
        occupied = _occupied()
        everybody = set().union(*occupied.values())
        if any(self._bind(one) for one in candidates if one not in everybody):
            return
        kept = set[int]().union(
            *(
                own
                for user, own in occupied.items()
                if user == os.getuid() or len(own) <= FAIR_SHARE
            )
        )
        hoarded = [one for one in candidates if one not in kept]
        if not hoarded:
            raise GraphError(f"no domain id is free within {LOWEST}..{HIGHEST}")
        self._bind(hoarded[0])

    def _bind(self, domain_id: int) -> bool:
        self.domain_id = domain_id
        claim = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            claim.bind(("127.0.0.1", _FIRST_PORT + _PORTS * domain_id + _CLAIM))
        except OSError:
            claim.close()
            return False
        self._socket = claim
        return True

    def release(self) -> None:
        """Give the domain id back; calling it again does nothing."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def __enter__(self) -> "Self":
        return self

    def __exit__(self, *_: object) -> None:
        self.release()


def _occupied() -> dict[int, set[int]]:
    """Return the domains in which each user, by number, has ports on this machine; see proc(5)."""
    occupied: dict[int, set[int]] = defaultdict(set)
    table = Path("/proc/net/udp")
    for row in table.read_text(encoding="ascii").splitlines()[1:] if table.exists() else []:
        fields = row.split()
        port, user = int(fields[1].rpartition(":")[2], 16), int(fields[7])
        domain_id = (port - _FIRST_PORT) // _PORTS
        if LOWEST <= domain_id <= HIGHEST:
            occupied[user].add(domain_id)
    return occupied
