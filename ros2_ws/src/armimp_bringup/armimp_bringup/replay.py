"""Playing bags through the graph into a live estimator node."""

from __future__ import annotations

import json
import tempfile
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from rclpy.node import Node
from rclpy.task import Future

from armimp_bringup.config import prepare_directory, require_unused
from armimp_bringup.graph import GraphContext
from armimp_bringup.nodes import ComposedNodes
from armimp_bringup.offline_estimate import read_bags
from armimp_bringup.orchestrator import PARAMETERS_FILE, Course, Supervisor, settle
from armimp_bringup.terminal import display
from armimp_common import topics
from armimp_common.cdr import encode_trial_status, stamp_of
from armimp_common.errors import GraphError
from armimp_common.executor import Spinner
from armimp_common.pubsub import create_publisher, subscribe_raw
from armimp_common.schema import to_params_yaml
from armimp_common.status import Phase, TrialStatus
from armimp_estimation.alignment.trial_windows import TrialWindow
from armimp_estimation.bags.reader import BagContent
from armimp_estimation.parameters import EstimatorParameters
from armimp_estimation.result import Result

_PLAYED = (*topics.DATA_STREAMS, topics.TRIAL)
_BATCH = 400
"""Messages under way at once: far less than the depth of the subscriptions."""
_TIMEOUT = 10.0  # s, longest wait for a batch to go through the graph
_ON_THE_WAY = 0.2
"""Time for messages to arrive whose arrival the player cannot observe (s)."""
_NEVER = 1_000_000
"""Trial number that no trial has."""


class BagPlayer(Node):
    """Publishes recorded messages unchanged, never more at once than readers can take."""

    def __init__(self, graph: GraphContext, spinner: Spinner) -> None:
        super().__init__("armimp_player", context=graph.context, use_global_arguments=False)
        self._spinner = spinner
        self._senders = {topic: create_publisher(self, topic) for topic in _PLAYED}
        # The player hears its own messages, which shows that a batch has gone through the graph.
        self._heard = 0
        self._expected = 0
        self._through: Future = Future()
        self._echo = subscribe_raw(self, topics.PERTURBATION, self._on_echo)

    def play(self, bag: BagContent, should_stop: Callable[[], bool]) -> None:
        """Play one bag as fast as the graph takes it, and end a trial that the bag cuts off.

        Raises
        ------
        GraphError
            If the messages don't go through.
        """
        messages, last = list(_with_statuses(bag)), bag.trials[-1].window
        if not last.ended and topics.COMMANDS in bag.topics:
            while messages[-1][0] != topics.COMMANDS:  # these belong to an incomplete sample
                messages.pop()
        for sent, (topic, message) in enumerate(messages, 1):
            self._senders[topic].publish(message)
            self._expected += topic == topics.PERTURBATION
            if sent % _BATCH == 0:
                self._wait()
                if should_stop():
                    return
        self._wait()
        if not last.ended:
            self._spinner.spin_until(Future(), _ON_THE_WAY)
            self._senders[topics.TRIAL].publish(_status(Phase.REST, replace(last, trial=_NEVER), 0))
            # It has to arrive before the next bag: the estimator first takes all samples it got.
            self._spinner.spin_until(Future(), _ON_THE_WAY)

    def finish(self, last: TrialWindow, trials: int) -> None:
        """Announce that nothing more will come."""
        self._senders[topics.TRIAL].publish(_status(Phase.DONE, last, trials))

    def _wait(self) -> None:
        if self._heard < self._expected:
            self._through = Future()
            if not self._spinner.spin_until(self._through, _TIMEOUT):
                raise GraphError(f"played messages did not arrive within {_TIMEOUT:g} s")

    def _on_echo(self, _: bytes) -> None:
        self._heard += 1
        if self._heard >= self._expected and not self._through.done():
            self._through.set_result(None)


def _with_statuses(bag: BagContent) -> Iterator[tuple[str, bytes]]:
    """Yield the messages of a bag, with inferred trial statuses if it has none."""
    if topics.TRIAL in bag.topics:
        yield from ((topic, raw) for topic, _, raw in bag.messages() if topic in _PLAYED)
        return
    windows = [trial.window for trial in bag.trials]
    due = deque(windows)
    present: TrialWindow | None = None
    for topic, _, raw in bag.messages():
        if topic not in _PLAYED:
            continue
        if due and topic != topics.COMMANDS and stamp_of(raw) >= due[0].start_ns:
            if present is not None:
                yield topics.TRIAL, _status(Phase.REST, present, len(windows))
            present = due.popleft()
            yield topics.TRIAL, _status(Phase.PERTURB, present, len(windows))
        yield topic, raw
    if present is not None and present.ended:
        yield topics.TRIAL, _status(Phase.REST, present, len(windows))


def _status(phase: Phase, window: TrialWindow, trials: int) -> bytes:
    return encode_trial_status(
        TrialStatus(
            phase=phase,
            trial=window.trial,
            trials=max(trials, window.trial),
            joint=window.joint,
            joint_name=window.joint_name,
            tick=0,
            start_ns=window.start_ns,
            ticks=window.ticks,
            seed=window.seed,
            valid=True,
        )
    )


def replay_bags(
    bags: Sequence[Path],
    estimators: tuple[str, ...],
    directory: Path | None,
    *,
    allow_gaps: bool = False,
    domain_id: int | None = None,
    interrupted: Callable[[], bool] = lambda: False,
) -> Result:
    """Play bags into an estimator node and return its result.

    Parameters
    ----------
    bags : together they hold one trial for each joint
    estimators : names; empty for the defaults
    directory : new directory for the results; None keeps no files
    allow_gaps : use the intact parts of trials that lost samples
    domain_id, interrupted : as for :func:`armimp_bringup.orchestrator.run_experiment`

    Raises
    ------
    BagError, DataError
        If the bags can't be read or don't belong together.
    GraphError
        If the graph fails.
    """
    if directory is not None:
        require_unused(directory)
    contents, metadata = read_bags(bags, allow_gaps=allow_gaps)
    with tempfile.TemporaryDirectory() as temporary:
        directory = directory or Path(temporary)
        parameters = EstimatorParameters(
            joints=contents[0].joint_names,
            estimators=estimators or EstimatorParameters().estimators,
            record=False,
            allow_gaps=allow_gaps,
            directory=str(directory.absolute()),
            metadata=json.dumps(metadata),
        )
        parameters.bag_metadata()
        with GraphContext(domain_id) as graph:
            # Made only once the domain is claimed, so that a failed claim leaves nothing behind.
            prepare_directory(directory)
            parameter_file = directory / PARAMETERS_FILE
            parameter_file.write_text(
                to_params_yaml({topics.ESTIMATOR_NODE: parameters}), encoding="utf-8"
            )
            supervisor = Supervisor(graph, display().show)
            with Spinner([supervisor]) as spinner:
                player = BagPlayer(graph, spinner)
                spinner.add_node(player)
                nodes = ComposedNodes(
                    graph.context, spinner, parameter_file, (topics.ESTIMATOR_NODE,)
                )

                def drive() -> None:
                    for content in contents:
                        player.play(content, interrupted)
                    player.finish(contents[-1].trials[-1].window, len(contents))
                    display().complete("estimating")

                course = Course(supervisor, spinner, nodes, interrupted=interrupted)
                try:
                    problems, result = course.run(drive)
                finally:
                    spinner.remove_node(player)
                    player.destroy_node()
        return settle(directory, parameters, result, problems)
