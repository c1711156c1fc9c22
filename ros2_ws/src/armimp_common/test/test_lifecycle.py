"""Lifecycle manager: nodes of this process and of others, refusals, failures, silence."""

from functools import partial

import pytest
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from std_msgs.msg import String

from armimp_common.errors import ConfigurationError, GraphError
from armimp_common.executor import Spinner, steady_timer
from armimp_common.lifecycle import LifecycleManager, ManagedNode
from armimp_common.schema import Schema
from support.graph import PATIENCE, Launch


class Managed(ManagedNode):
    fault: Exception | None = None

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.create_publisher(String, "made", 1)
        self.create_subscription(String, "made", lambda _: None, 1)
        steady_timer(self, 1.0, lambda: None)
        if self.fault is not None:
            raise self.fault
        return TransitionCallbackReturn.SUCCESS


@pytest.fixture
def managed(launch: Launch) -> Managed:
    made: Managed = launch(partial(Managed, "managed"), Schema())
    return made


@pytest.fixture
def manager(node: Node, spinner: Spinner, managed: Managed) -> LifecycleManager:
    return LifecycleManager(node, ["managed"], spinner=spinner, timeout=PATIENCE)


@pytest.mark.parametrize("number", [0, 3, 4, 99, 255])
def test_a_transition_that_there_is_not_is_refused_and_the_node_lives(
    manager: LifecycleManager, node: Node, spinner: Spinner, number: int
) -> None:
    manager.wait_for_nodes()
    client = node.create_client(ChangeState, "managed/change_state")
    assert client.wait_for_service(PATIENCE)
    future = client.call_async(ChangeState.Request(transition=Transition(id=number)))
    assert spinner.spin_until(future, PATIENCE)
    assert not future.result().success
    manager.change("managed", "configure")
    assert manager.state("managed") == "inactive"


def test_when_state_lacks_the_transition_expect_graph_error_and_node_alive(
    manager: LifecycleManager,
) -> None:
    with pytest.raises(
        GraphError,
        match=r"^node managed cannot activate: it is unconfigured,"
        r" which allows configure, shutdown$",
    ):
        manager.change("managed", "activate")

    manager.change("managed", "configure")
    assert manager.state("managed") == "inactive"


def test_when_transition_fails_expect_graph_error_and_the_reason_kept(
    manager: LifecycleManager, managed: Managed, capfd: pytest.CaptureFixture[str]
) -> None:
    managed.fault = ConfigurationError("rate = 0: must be positive")

    with pytest.raises(GraphError, match=r"^node managed failed to configure"):
        manager.change("managed", "configure")

    assert manager.state("managed") == "unconfigured"
    assert managed.transition_error == "rate = 0: must be positive"
    log = capfd.readouterr().err
    assert "on_configure: rate = 0: must be positive" in log
    assert "Traceback" not in log
    managed.fault = None
    manager.change("managed", "configure")
    assert managed.transition_error == ""


def test_what_a_configuration_created_is_gone_after_the_cleanup_even_if_it_failed(
    managed: Managed,
) -> None:
    def there() -> list[object]:
        return [*managed.publishers, *managed.subscriptions, *managed.timers]

    before = there()
    managed.fault = ConfigurationError("rate = 0: must be positive")
    managed.trigger_configure()
    managed.fault = None
    managed.trigger_configure()
    assert len(there()) == len(before) + 6
    managed.trigger_cleanup()
    assert there() == before


def test_when_waiting_is_vain_expect_its_reason_at_once(node: Node, managed: Managed) -> None:
    asked = 0

    def check() -> None:
        nonlocal asked
        asked += 1
        if asked > 3:
            raise GraphError("the process died")

    with Spinner([node]) as spinner:  # which does not spin the managed node
        manager = LifecycleManager(
            node, ["managed", "absent"], spinner=spinner, timeout=1000.0, check=check
        )
        for wait in (
            manager.wait_for_nodes,
            lambda: manager.change("absent", "configure"),
            lambda: manager.change("managed", "configure"),
        ):
            asked = 0
            with pytest.raises(GraphError, match=r"^the process died$"):
                wait()
