"""Streams fed with messages by hand, without a middleware, and trials assembled from them."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeAlias, TypeVar

from pydantic import BaseModel

from armimp_common.cdr import decode_trial_status, decode_trial_statuses
from armimp_common.status import Phase, TrialStatus
from armimp_common.topics import DATA_STREAMS, PERTURBATION, TRIAL
from armimp_estimation.alignment.assemble import Trial, assemble_trials
from armimp_estimation.alignment.streams import decode_streams
from armimp_estimation.alignment.synchronizer import StreamSynchronizer
from armimp_estimation.recorder import TrialRecorder
from support.synthetic_bags import Message

ModelT = TypeVar("ModelT", bound=BaseModel)
Topics: TypeAlias = dict[str, list[bytes]]


def statuses_of(topics: Topics) -> list[TrialStatus]:
    statuses, problem = decode_trial_statuses(topics.get(TRIAL, []))
    assert not problem
    return statuses


def trials_of(
    topics: Topics,
    statuses: Sequence[TrialStatus] | None = None,
    joint_names: Sequence[str] = ("shoulder", "elbow"),
) -> list[Trial]:
    """Trials assembled from messages, with other statuses than theirs if these are given."""
    streams = decode_streams(joint_names, topics)
    return list(assemble_trials(streams, statuses_of(topics) if statuses is None else statuses))


def fed_synchronizer() -> tuple[StreamSynchronizer, dict[str, Callable[[bytes], None]]]:
    """A synchronizer, and for each stream a function that hands it a message."""
    waiting: dict[str, list[bytes]] = {topic: [] for topic in DATA_STREAMS}

    def source(topic: str) -> Callable[[], Sequence[bytes]]:
        def take() -> Sequence[bytes]:
            taken, waiting[topic][:] = list(waiting[topic]), []
            return taken

        return take

    sources = {topic: source(topic) for topic in DATA_STREAMS}
    receivers = {topic: messages.append for topic, messages in waiting.items()}
    return StreamSynchronizer(sources), receivers


def record(
    recorder: TrialRecorder,
    messages: Iterable[Message],
    together: int = 1,
    on_recorded: Callable[[], object] = lambda: None,
) -> None:
    """Hand a recorder the messages as the node does, so many samples at a time."""
    synchronizer, receivers = fed_synchronizer()
    led = 0
    for topic, _, raw in messages:
        if topic == TRIAL:
            recorder.add(synchronizer.take())
            recorder.add_status(decode_trial_status(raw))
            continue
        receivers[topic](raw)
        led += topic == PERTURBATION
        if topic == PERTURBATION and led % together == 0:
            recorder.add(synchronizer.take())
            on_recorded()
    recorder.add(synchronizer.take(incomplete=True))


def trial_status(**values: Any) -> TrialStatus:
    """A status of the first of two trials, perturbing the shoulder, with some values changed."""
    usual: dict[str, Any] = {
        "phase": Phase.PERTURB,
        "trial": 1,
        "trials": 2,
        "joint": 0,
        "joint_name": "shoulder",
        "tick": 500,
        "start_ns": 500_000_000,
        "ticks": 2000,
        "seed": 1,
        "valid": True,
    }
    return TrialStatus(**{**usual, **values})


def changed(record: ModelT, **values: Any) -> ModelT:
    """The record with some values changed."""
    return type(record)(**{**dict(record), **values})
