"""Streams whose messages are handed in, where no middleware keeps them."""

from collections.abc import Callable, Sequence

from armimp_common.topics import PERTURBATION
from armimp_estimation.alignment.synchronizer import FETCHED, StreamSynchronizer


def fed_synchronizer(
    on_samples: Callable[[int], None] = lambda _: None,
    on_behind: Callable[[], None] = lambda: None,
) -> tuple[StreamSynchronizer, dict[str, Callable[[bytes], None]]]:
    """A synchronizer, and what takes the messages of each stream for it."""
    waiting: dict[str, list[bytes]] = {topic: [] for topic in FETCHED}

    def source(topic: str) -> Callable[[], Sequence[bytes]]:
        def take() -> Sequence[bytes]:
            taken, waiting[topic][:] = list(waiting[topic]), []
            return taken

        return take

    sources = {topic: source(topic) for topic in FETCHED}
    synchronizer = StreamSynchronizer(sources, on_samples, on_behind)
    receivers = {topic: messages.append for topic, messages in waiting.items()}
    return synchronizer, {**receivers, PERTURBATION: synchronizer.receive}
