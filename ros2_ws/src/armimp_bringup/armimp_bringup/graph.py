"""The ROS context of an experiment: its domain, and who can reach it."""

from __future__ import annotations

import gc
import os
from collections.abc import Mapping
from pathlib import Path

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from armimp_common.domain import DomainClaim
from armimp_common.errors import ConfigurationError, GraphError
from armimp_common.executor import NO_LOG_FILES
from armimp_common.process import reachable_from_outside

_RANGE, _PROFILES = "ROS_AUTOMATIC_DISCOVERY_RANGE", "FASTRTPS_DEFAULT_PROFILES_FILE"
_OLD_RANGE, _DOMAIN = "ROS_LOCALHOST_ONLY", "ROS_DOMAIN_ID"


OPEN = Path(__file__).with_name("fastdds.xml")
"""Profile of the middleware for any network."""
LOOPBACK = Path(__file__).with_name("fastdds_loopback.xml")
"""Profile with which other machines cannot reach it."""


class GraphContext:
    """A ROS context of its own, out of reach and hearing of everything else.

    It lives in a domain that no other experiment has, and other machines cannot reach it, unless
    the environment or the caller chooses otherwise. Child processes inherit all that by environment
    variables, which are as they were after `close`.

    The range of discovery that ROS calls ``LOCALHOST`` is not enough: it finds nobody on other
    machines, but its sockets are open to them.

    Parameters
    ----------
    domain_id : int or None
        The domain; None takes a free one.

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
                # The middleware reads profiles once in each process, and had done so before.
                self.context.try_shutdown()
                _set_variables({_RANGE: "LOCALHOST"})
                self.context = Context()
                self._join()
                _set_variables(variables)
        except RuntimeError as error:
            self.close()
            # The errors of rclpy, as with security asked of a middleware that has none.
            raise GraphError(f"ROS cannot be started: {' '.join(str(error).split())}") from None
        except BaseException:
            self.close()
            raise

    def _join(self) -> None:
        rclpy.init(
            # No log files in the home directory, which may be missing or full.
            args=["--ros-args", NO_LOG_FILES],
            context=self.context,
            domain_id=self.claim.domain_id,
            signal_handler_options=SignalHandlerOptions.NO,
        )

    def _is_open(self) -> bool:
        """Whether other machines can reach this process; there are sockets only with a node."""
        node = Node("armimp_socket_check", context=self.context, use_global_arguments=False)
        try:
            return bool(reachable_from_outside())
        except OSError:  # no Linux
            return True
        finally:
            node.destroy_node()

    def close(self) -> None:
        """Shut the context down, give the domain back, and restore the environment."""
        # A lifecycle node that was destroyed stays in the graph, with all sockets and threads, as
        # long as its services are there, which only the garbage collector finds.
        gc.collect()
        self.context.try_shutdown()
        self.claim.release()
        _set_variables(self._before)

    def __enter__(self) -> GraphContext:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _set_variables(variables: Mapping[str, str | None]) -> None:
    for name, value in variables.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value


def _reach() -> dict[str, str | None]:
    """Variables of the environment that say who can be heard and reached; None: not there."""
    reach, profiles = os.environ.get(_RANGE, "LOCALHOST"), os.environ.get(_PROFILES)
    if profiles is not None:
        return {_RANGE: reach, _PROFILES: profiles}
    if reach == "LOCALHOST":
        # With this range, or the variable that was there before it, the middleware would put
        # transports of its own in the place of those of the profile.
        return {_RANGE: "SYSTEM_DEFAULT", _PROFILES: str(LOOPBACK), _OLD_RANGE: None}
    return {_RANGE: reach, _PROFILES: str(OPEN)}


def external_domain(domain_id: int | None) -> int:
    """Return the domain that nodes started by others are in: the given one, or where ROS looks.

    Raises
    ------
    ConfigurationError
        If the variable of the environment holds no number.
    """
    if domain_id is not None:
        return domain_id
    text = os.environ.get(_DOMAIN) or "0"
    if not text.isdecimal():
        raise ConfigurationError(f"{_DOMAIN} is no number: {text!r}")
    return int(text)
