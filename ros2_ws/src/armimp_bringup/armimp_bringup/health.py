"""Health of a node, for containers: ``python -m armimp_bringup.health NODE``.

Exit status 0 if the node answers and is not finalized, else 1 with one line that says why. Domain
and reach are those of the environment.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from armimp_common.errors import GraphError
from armimp_common.executor import Spinner
from armimp_common.lifecycle import LifecycleManager

_PATIENCE = 5.0


def state_of(name: str, patience: float = _PATIENCE) -> str:
    """Return the lifecycle state of a node, waiting for node and answer that long each, s.

    Raises
    ------
    GraphError
        If it is not there or does not answer.
    """
    context = Context()
    rclpy.init(args=[], context=context, signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = Node("armimp_health", context=context, use_global_arguments=False)
        try:
            with Spinner([node]) as spinner:
                manager = LifecycleManager(
                    node, [name], spin_until=spinner.spin_until, timeout=patience
                )
                manager.wait_for_nodes()
                return manager.state(name)
        finally:
            node.destroy_node()
    finally:
        context.try_shutdown()


def main(arguments: Sequence[str] | None = None) -> int:
    """Look at one node, and return the exit status."""
    names = sys.argv[1:] if arguments is None else arguments
    if len(names) != 1:
        print("usage: python -m armimp_bringup.health NODE", file=sys.stderr)
        return 2
    try:
        state = state_of(names[0])
    except GraphError as error:
        print(error, file=sys.stderr)
        return 1
    print(f"node {names[0]} is {state}")
    return 1 if state == "finalized" else 0


if __name__ == "__main__":
    sys.exit(main())
