"""Subscriptions in which an executor finds what it needs without running Python code for it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from rclpy.subscription import Subscription


class LeanSubscription(Subscription):
    """A subscription with attributes where rclpy has properties.

    For each message the events executor asks for the handle, the callback and its kind. In rclpy
    those are properties and members of an enumeration, whose getters are Python functions.

    A data descriptor, as a property is, comes before the attributes of an instance; what stands
    here does not.
    """

    handle: Any = None
    callback: Any = None
    CallbackType: Any = Subscription.CallbackType


def make_lean(subscription: Subscription) -> None:
    """Have a subscription of rclpy answer sooner; one of any other make stays as it is.

    The callback cannot be exchanged for one of another kind afterwards.
    """
    if type(subscription) is not Subscription:
        return
    kinds = type(subscription).CallbackType
    # Both executors compare with these; the one that is not the events executor, by identity
    # with `_callback_type`, which therefore stays a member of the enumeration.
    lean = SimpleNamespace(**{kind.name: SimpleNamespace(value=kind.value) for kind in kinds})
    found = {
        "handle": subscription.handle,
        "callback": subscription.callback,
        "CallbackType": lean,
    }
    subscription.__class__ = LeanSubscription
    vars(subscription).update(found)
