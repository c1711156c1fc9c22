"""Which topic of a bag is which topic of the contract, whatever namespace it was recorded in."""

from collections.abc import Sequence
from typing import Final

from armimp_common.errors import BagError
from armimp_common.topics import JOINT_STATES, MESSAGE_TYPES, PERTURBATION, TORQUE_SENSORS, TRIAL

_NEEDED: Final[dict[str, str]] = {
    JOINT_STATES: "joint positions",
    TORQUE_SENSORS: "torque readings",
    PERTURBATION: "perturbation",
}

_SHOWN: Final = 5
"""Names that a message lists."""


def contract_topic(name: str) -> str | None:
    """Topic of the contract of which this may be the name in a bag; None if there is none."""
    return next((topic for topic in MESSAGE_TYPES if _prefix(name, topic) is not None), None)


def resolve_topics(
    recorded: Sequence[tuple[str, str]], *, bag: str, namespace: str | None = None
) -> dict[str, int]:
    """Find the topics of the contract among those of a bag.

    A topic matches if its name ends with that of the contract, at a slash. Where several do,
    the namespace decides under which all needed topics are.

    Parameters
    ----------
    recorded : sequence of tuple of str
        Name and message type of each topic of the bag; the type may be empty.
    bag : str
        The bag for error messages.
    namespace : str, optional
        Accept only topics under this namespace.

    Returns
    -------
    dict of str to int
        Name in the contract, to index in `recorded`. Only what is there is in it.

    Raises
    ------
    BagError
        If the choice is not clear, or a topic has another type than it must have.
    """
    if namespace is not None:
        wanted = "/" + namespace.strip("/") + "/" if namespace.strip("/") else "/"
        prefixes = [wanted]
    else:
        prefixes = _complete_prefixes(recorded)
    if len(prefixes) > 1:
        names = _listed([prefix.rstrip("/") or "/" for prefix in prefixes])
        raise BagError(f"{bag}: holds the topics of several rigs, choose a namespace: {names}")
    found: dict[str, int] = {}
    for topic in MESSAGE_TYPES:
        matches = _candidates(recorded, topic)
        if prefixes:
            under = [i for i in matches if _prefix(recorded[i][0], topic) in (prefixes[0], "")]
            # Those not needed may be recorded elsewhere, if only once.
            matches = under if under or topic in _NEEDED or namespace is not None else matches
        if len(matches) > 1 and (topic in _NEEDED or topic == TRIAL):
            names = _listed(sorted({recorded[i][0] for i in matches}))
            raise BagError(f"{bag}: {topic} is ambiguous: {names}")
        if len(matches) == 1:
            _check_type(recorded[matches[0]], topic, bag)
            found[topic] = matches[0]
    return found


def require_topics(found: dict[str, int], *, bag: str) -> None:
    """Check that everything is there which an estimate is made from.

    Raises
    ------
    BagError
        If a topic is missing.
    """
    for topic, content in _NEEDED.items():
        if topic not in found:
            raise BagError(f"{bag}: has no {content}: no topic {topic}")


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return ", ".join(names[:_SHOWN]) + more


def _complete_prefixes(recorded: Sequence[tuple[str, str]]) -> list[str]:
    """Prefixes under which all needed topics are."""
    sets = [
        {_prefix(recorded[i][0], topic) or "" for i in _candidates(recorded, topic)}
        for topic in _NEEDED
    ]
    return sorted(set.intersection(*sets))


def _candidates(recorded: Sequence[tuple[str, str]], topic: str) -> list[int]:
    """Topics with the right name, and where there are such, the right type."""
    named = [i for i, (name, _) in enumerate(recorded) if _prefix(name, topic) is not None]
    typed = [i for i in named if recorded[i][1] == MESSAGE_TYPES[topic]]
    return typed or named


def _prefix(name: str, topic: str) -> str | None:
    """What stands before a topic of the contract; None if the name is not that of the topic."""
    if name == topic:
        return ""
    tail = topic if topic.startswith("/") else "/" + topic
    if not name.endswith(tail):
        return None
    return name[: len(name) - len(tail) + 1]


def _check_type(recorded: tuple[str, str], topic: str, bag: str) -> None:
    name, message_type = recorded
    expected = MESSAGE_TYPES[topic]
    if message_type not in ("", expected):
        raise BagError(f"{bag}: topic {name} is of type {message_type}, not {expected}")
