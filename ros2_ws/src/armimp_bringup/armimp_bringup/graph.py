"""The ROS context of an experiment: its domain, and who can reach it."""

from __future__ import annotations

import gc
import os
import random
import socket
from collections import defaultdict
from collections.abc import Mapping
from contextlib import AbstractContextManager
from ipaddress import ip_address
from pathlib import Path
from typing import Final

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from armimp_common.errors import ConfigurationError, GraphError
from armimp_common.executor import NO_LOG_FILES

_RANGE, _PROFILES = "ROS_AUTOMATIC_DISCOVERY_RANGE", "FASTRTPS_DEFAULT_PROFILES_FILE"
_OLD_RANGE, _DOMAIN = "ROS_LOCALHOST_ONLY", "ROS_DOMAIN_ID"

OPEN = Path(__file__).with_name("fastdds.xml")
"""Profile of the middleware for any network."""
LOOPBACK = Path(__file__).with_name("fastdds_loopback.xml")
"""Profile of the middleware that keeps it out of reach of other machines."""
LOWEST: Final = 1
HIGHEST: Final = 100
"""Domain ids beyond 101 collide with ephemeral ports on Linux; 0 is everybody's default."""
FAIR_SHARE: Final = HIGHEST // 2
"""A user who occupies more domains than this loses the exclusive right to them."""
_FIRST_PORT: Final = 7400
_PORTS: Final = 250
"""Ports of a domain: the middleware binds ``7400 + 250 d`` to ``+ 249``, but never ``+ _CLAIM``."""
_CLAIM: Final = 2


class DomainClaim(socket.socket):
    """A domain id held by this process until it is closed, or until the process ends.

    The claim is a UDP port of the domain that the middleware leaves free, bound on the loopback
    interface. So it is exclusive between all users, leaves nothing behind after a crash, and needs
    no writable directory; a lock file would belong to the user who made it first, who could keep
    all others out. The claim chooses a domain in which no program of this machine has a port. No
    user can keep the others out: if no domain is free, one is taken from a user who occupies more
    than `FAIR_SHARE` of them.

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
        if domain_id is not None and not 0 <= domain_id <= HIGHEST:
            raise ConfigurationError(f"domain id is not within 0..{HIGHEST}: {domain_id}")
        super().__init__(socket.AF_INET, socket.SOCK_DGRAM)
        if domain_id is None:
            self._take_any()
        elif not self._take(domain_id):
            self.close()
            raise GraphError(f"domain id {domain_id} is taken by another experiment")

    def _take_any(self) -> None:
        candidates = list(range(LOWEST, HIGHEST + 1))
        # Not the seeded generator of an experiment: two equal experiments must differ here.
        random.SystemRandom().shuffle(candidates)
        occupied = _occupied()
        everybody = set().union(*occupied.values())
        if any(self._take(one) for one in candidates if one not in everybody):
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
            self.close()
            raise GraphError(f"no domain id is free within {LOWEST}..{HIGHEST}")
        # Any of them, even if its port is taken.
        any(self._take(one) for one in hoarded)

    def _take(self, domain_id: int) -> bool:
        self.domain_id = domain_id
        try:
            self.bind(("127.0.0.1", _FIRST_PORT + _PORTS * domain_id + _CLAIM))
        except OSError:
            return False
        return True


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


class GraphContext(AbstractContextManager["GraphContext"]):
    """A ROS context that is isolated from everything else.

    It lives in a domain that no other experiment has, and other machines cannot reach it, unless
    the environment or the caller chooses otherwise. Child processes inherit all that by environment
    variables, which `close` restores.

    The range of discovery that ROS calls ``LOCALHOST`` is not enough: it finds nobody on other
    machines, but its sockets are open to them.

    Parameters
    ----------
    domain_id : the domain; None takes a free one

    Raises
    ------
    ConfigurationError, GraphError
        If there is no such domain, or it is taken, or ROS cannot be started.
    """

    def __init__(self, domain_id: int | None = None) -> None:
        self.claim = DomainClaim(domain_id)
        # Read by the middleware when the context is made; child processes inherit them.
        variables = {**_reach(), _DOMAIN: str(self.claim.domain_id)}
        self._before = {name: os.environ.get(name) for name in variables}
        _set_variables(variables)
        self.context = Context()
        try:
            self._join()
            if variables[_PROFILES] == str(LOOPBACK) and self._is_open():
                # The middleware reads profiles once in each process, and has already done so.
                self.context.try_shutdown()
                _set_variables({_RANGE: "LOCALHOST"})
                self.context = Context()
                self._join()
                _set_variables(variables)
        except BaseException as error:
            self.close()
            if not isinstance(error, RuntimeError):
                raise
            # Raised by rclpy, for example if security is requested of a middleware without it.
            raise GraphError(f"ROS cannot be started: {' '.join(str(error).split())}") from None

    def _join(self) -> None:
        rclpy.init(
            # No log files in the home directory, which may be missing or full.
            args=["--ros-args", NO_LOG_FILES],
            context=self.context,
            domain_id=self.claim.domain_id,
            signal_handler_options=SignalHandlerOptions.NO,
        )

    def _is_open(self) -> bool:
        """Whether other machines can reach this process; sockets exist only with a node."""
        import psutil  # here, as few processes need it

        node = Node("armimp_socket_check", context=self.context, use_global_arguments=False)
        try:
            sockets = psutil.Process().net_connections("inet")
        except psutil.Error:  # the system does not say
            return True
        finally:
            node.destroy_node()
        listening = (one for one in sockets if one.status in (psutil.CONN_NONE, psutil.CONN_LISTEN))
        return any(not ip_address(one.laddr.ip).is_loopback for one in listening if one.laddr)

    def close(self) -> None:
        """Shut the context down, give the domain back, and restore the environment."""
        # A lifecycle node that was destroyed stays in the graph, with all sockets and threads, as
        # long as its services are there, which only the garbage collector finds.
        gc.collect()
        self.context.try_shutdown()
        self.claim.close()
        _set_variables(self._before)

    def __exit__(self, *_: object) -> None:
        self.close()


def _set_variables(variables: Mapping[str, str | None]) -> None:
    for name, value in variables.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value


def _reach() -> dict[str, str | None]:
    """Return the environment variables that say who can be heard and reached; None: unset."""
    reach, profiles = os.environ.get(_RANGE, "LOCALHOST"), os.environ.get(_PROFILES)
    if profiles is not None:
        return {_RANGE: reach, _PROFILES: profiles}
    if reach == "LOCALHOST":
        # With this range, or the older variable for it, the middleware would replace the transports
        # of the profile by its own.
        return {_RANGE: "SYSTEM_DEFAULT", _PROFILES: str(LOOPBACK), _OLD_RANGE: None}
    return {_RANGE: reach, _PROFILES: str(OPEN)}


def external_domain(domain_id: int | None) -> int:
    """Return the domain of nodes started by others: the given one, or that of the environment.

    Raises
    ------
    ConfigurationError
        If the environment variable does not hold a number.
    """
    if domain_id is not None:
        return domain_id
    text = os.environ.get(_DOMAIN) or "0"
    if not text.isdecimal():
        raise ConfigurationError(f"{_DOMAIN} is no number: {text!r}")
    return int(text)
