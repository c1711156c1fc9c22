"""Conversions between nanoseconds, control ticks and ROS time messages."""

from builtin_interfaces.msg import Time

from armimp_common.contract import NS_PER_S, PERIOD_NS


def to_time(stamp_ns: int) -> Time:
    """Return the message for a stamp (ns).

    Raises
    ------
    AssertionError
        From the message class, if the seconds do not fit 32 bits.
    """
    sec, nanosec = divmod(stamp_ns, NS_PER_S)
    return Time(sec=sec, nanosec=nanosec)


def to_ns(time: Time) -> int:
    """Return the stamp (ns) of a message."""
    return int(time.sec) * NS_PER_S + int(time.nanosec)


def tick_to_ns(tick: int, start_ns: int = 0) -> int:
    """Return the stamp (ns) of control tick `tick`, counted from the one at `start_ns`."""
    return start_ns + tick * PERIOD_NS


def ns_to_tick(stamp_ns: int, start_ns: int = 0) -> int:
    """Return the control tick nearest to a stamp (ns), counted from the one at `start_ns`."""
    return (stamp_ns - start_ns + PERIOD_NS // 2) // PERIOD_NS


def ns_to_seconds(stamp_ns: int) -> float:
    """Return a duration or stamp in seconds; for display, as it may round."""
    return stamp_ns / NS_PER_S
