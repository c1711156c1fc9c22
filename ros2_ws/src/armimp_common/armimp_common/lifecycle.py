"""Lifecycle transitions: request them from outside, and report why one failed."""

from __future__ import annotations

import math
import time
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any, Final, Literal, TypeAlias, get_args

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions, GetState
from rclpy.client import Client
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import Trigger

from armimp_common.errors import ArmimpError, GraphError
from armimp_common.executor import Spinner
from armimp_common.heartbeat import offer_heartbeat

TransitionName: TypeAlias = Literal["configure", "activate", "deactivate", "cleanup", "shutdown"]

_SERVICES: Final[dict[str, Any]] = {
    "change_state": ChangeState,
    "get_state": GetState,
    "get_available_transitions": GetAvailableTransitions,
}
_POLL: Final = 0.01
_CHECK_PERIOD: Final = 0.05
_REPEAT: Final = 2.0
"""Times between two checks for a service, two checks for an answer, and two equal requests (s)."""


class ServiceClients:
    """Clients of the same services of several nodes, which wait for services and answers.

    Parameters
    ----------
    node : the node that holds the clients; it must be spun by `spinner`
    names : names of the nodes, absolute or relative to the namespace of `node`
    kinds : types of the services by name
    spinner : spins during each wait; if the nodes are in the same process, it must spin them too
    timeout : longest wait for each service to appear, and for each answer (s)
    check : called often during each wait, which ends with any exception that it raises; meant for
        what makes waiting futile, like the death of a process
    """

    def __init__(
        self,
        node: Node,
        names: Iterable[str],
        kinds: Mapping[str, Any],
        *,
        spinner: Spinner,
        timeout: float,
        check: Callable[[], None] = lambda: None,
    ) -> None:
        self._node, self._spin_until = node, spinner.spin_until
        self._timeout, self._check = timeout, check
        self._clients: dict[tuple[str, str], Client] = {
            (name, service): node.create_client(kind, f"{name}/{service}")
            for name in names
            for service, kind in kinds.items()
        }

    def _await(
        self, clients: Mapping[tuple[str, str], Client], deadline: float, failure: str
    ) -> None:
        """Wait until services are there; raise GraphError if one is missing at the deadline (s)."""
        while missing := sorted(
            {name for (name, _), one in clients.items() if not one.service_is_ready()}
        ):
            if time.monotonic() >= deadline:
                raise GraphError(f"{failure}: {', '.join(missing)}")
            self._check()
            self._spin_until(Future(), _POLL)

    def _ask(
        self, name: str, service: str, request: Any, purpose: str, *, repeat: bool = True
    ) -> Any:
        """Wait for a service, call it, and return the answer.

        The purpose appears in errors; with `repeat`, a request without an answer is sent again.
        Raises a GraphError if there is no answer in time.
        """
        client, deadline = self._clients[name, service], time.monotonic() + self._timeout
        self._await({(name, service): client}, deadline, f"no node that could {purpose}")
        while True:
            # An answer gets lost if the node has not yet discovered this side.
            end = min(deadline, time.monotonic() + (_REPEAT if repeat else math.inf))
            future = client.call_async(request)
            try:
                while not self._spin_until(future, _CHECK_PERIOD):
                    self._check()
                    if time.monotonic() >= end:
                        break
                else:
                    return future.result()
            finally:
                if not future.done():
                    client.remove_pending_request(future)
            if time.monotonic() >= deadline:
                raise GraphError(f"node {name} did not answer to {purpose} in {self._timeout} s")


class LifecycleManager(ServiceClients):
    """Asks lifecycle nodes, of this process or of others, to change their state.

    A third-party node may end with an exception when it is asked for a transition that its state
    does not have (:class:`ManagedNode` does not end), so the available ones are always queried.

    Parameters
    ----------
    node, names, options : as for :class:`ServiceClients`; the timeout has to cover discovery and
        slow transitions
    """

    def __init__(self, node: Node, names: Sequence[str], **options: Any) -> None:
        super().__init__(node, names, _SERVICES, **options)
        self.names = tuple(names)

    def wait_for_nodes(self, timeout: float | None = None) -> None:
        """Wait until the services of all managed nodes are there.

        Raises
        ------
        GraphError
            Naming the nodes that did not appear.
        """
        deadline = time.monotonic() + (self._timeout if timeout is None else timeout)
        self._await(self._clients, deadline, "node did not appear")

    def state(self, name: str) -> str:
        """Return the state of a node, such as ``inactive``; GraphError if it does not answer."""
        answer = self._ask(name, "get_state", GetState.Request(), "get_state")
        return str(answer.current_state.label)

    def change(self, name: str, transition: TransitionName) -> None:
        """Ask a node for a transition and wait until it is complete.

        Raises
        ------
        GraphError
            If the node does not answer, is not in a state that has this transition, or fails
            to make it; the message names node and transition.
        """
        request = GetAvailableTransitions.Request()
        answer = self._ask(name, "get_available_transitions", request, transition)
        available = {
            str(item.transition.label): int(item.transition.id)
            for item in answer.available_transitions
        }
        if transition not in available:
            raise GraphError(
                f"node {name} cannot {transition}: it is {self.state(name)},"
                f" which allows {', '.join(available) or 'nothing'}"
            )
        chosen = Transition(id=available[transition], label=transition)
        request = ChangeState.Request(transition=chosen)
        # Queries may be repeated; a transition may not, but queries of the same node go before it.
        if not self._ask(name, "change_state", request, transition, repeat=False).success:
            raise GraphError(f"node {name} failed to {transition}; its log tells why")


class ManagedNode(LifecycleNode):
    """A lifecycle node that refuses an impossible transition, which would end a plain rclpy node.

    It offers a heartbeat under its name. Publishers, subscriptions and timers that `on_configure`
    creates are destroyed after `on_cleanup`.

    An `ArmimpError` of an ``on_configure``... method is logged on one line and fails the
    transition, so that the node stays as it was; any other exception is logged with its traceback.
    (rclpy turns every exception into the state "error processing" and says nothing.)

    Attributes
    ----------
    transition_error : the line that says why the last transition failed, empty if it did not
    """

    def __init__(self, name: str, **kwargs: Any) -> None:
        self.transition_error = ""
        self._configured: dict[Any, Callable[[Any], object]] = {}
        for transition in get_args(TransitionName):
            called = f"on_{transition}"
            setattr(self, called, partial(self._change, called, getattr(self, called)))
        super().__init__(name, **kwargs)
        offer_heartbeat(self, name)

    def _change(
        self,
        called: str,
        act: Callable[[LifecycleState], TransitionCallbackReturn],
        state: LifecycleState,
    ) -> TransitionCallbackReturn:
        self.transition_error = ""
        before = self._made()
        try:
            return act(state)
        except ArmimpError as error:
            self.transition_error = str(error)
            self.get_logger().error(f"{called}: {error}")
            return TransitionCallbackReturn.FAILURE
        except Exception as error:  # noqa: BLE001 (a transition must return, whatever happens)
            self.transition_error = f"{type(error).__name__}: {error}"
            self.get_logger().error(f"{called}: {traceback.format_exc()}")
            return TransitionCallbackReturn.ERROR
        finally:
            if called == "on_configure":
                made = self._made()
                self._configured |= {one: made[one] for one in made.keys() - before.keys()}
            elif called == "on_cleanup":
                for one, destroy in self._configured.items():
                    destroy(one)
                self._configured.clear()

    def _made(self) -> dict[Any, Callable[[Any], object]]:
        """Return publishers, subscriptions and timers, with what destroys them."""
        return {
            **dict.fromkeys(self.publishers, self.destroy_publisher),
            # Not `self.subscriptions`, from which a subclass may hide some.
            **dict.fromkeys(super().subscriptions, self.destroy_subscription),
            **dict.fromkeys(self.timers, self.destroy_timer),
        }

    def offer_trigger(self, name: str, act: Callable[[], tuple[bool, str]]) -> None:
        """Offer a ``std_srvs/Trigger`` service; `act` returns its success and its message."""

        def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            response.success, response.message = act()
            return response

        self.create_service(Trigger, name, answer)

    def _LifecycleNodeMixin__on_change_state(
        self, request: ChangeState.Request, response: ChangeState.Response
    ) -> ChangeState.Response:
        try:
            # Type stubs lack private names; rclpy has had this one since its mixin was introduced.
            parent: Any = super()
            answer: ChangeState.Response = parent._LifecycleNodeMixin__on_change_state(
                request, response
            )
            return answer
        except RuntimeError as error:  # from rcl, which then has made no transition
            self.get_logger().error(f"transition {request.transition.id} is refused: {error}")
            response.success = False
            return response
