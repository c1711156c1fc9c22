"""The topics are complete: each has a type, a profile, and a field for its numbers."""

from rclpy.qos import DurabilityPolicy, HistoryPolicy, ReliabilityPolicy

from armimp_common import qos, topics


def test_every_topic_has_a_type_and_a_profile() -> None:
    named = {
        value
        for name, value in vars(topics).items()
        if name.isupper() and isinstance(value, str) and not name.endswith(("_NODE", "_SERVICE"))
    }
    assert named == set(topics.MESSAGE_TYPES) == set(qos.PROFILES)
    assert {topic for topic in named if topic.startswith("/")} == {"/clock", "/diagnostics"}
    states = {topic for topic, kind in topics.MESSAGE_TYPES.items() if kind.endswith("/JointState")}
    assert states == set(topics.VALUE_FIELD)


def test_streams_lose_nothing_and_results_wait_for_whoever_is_late() -> None:
    for topic in topics.DATA_STREAMS:
        profile = qos.PROFILES[topic]
        assert profile.reliability is ReliabilityPolicy.RELIABLE
        assert (profile.history, profile.depth) == (HistoryPolicy.KEEP_LAST, 2000)
        assert profile.durability is DurabilityPolicy.VOLATILE
    for topic in (topics.TRIAL, topics.RESULT):
        assert qos.PROFILES[topic].durability is DurabilityPolicy.TRANSIENT_LOCAL
