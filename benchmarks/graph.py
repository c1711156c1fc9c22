"""What a tick of the node graph costs, compared with the bare exchange of the same messages."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import mean, median
from typing import Any, Literal

import yaml
from rclpy.context import Context
from rclpy.node import Node
from std_msgs.msg import UInt64

from armimp_bringup.bench import Measured
from armimp_bringup.config import ExperimentConfig
from armimp_bringup.graph import GraphContext
from armimp_bringup.nodes import NodeGroup, SeparateNodes
from armimp_bringup.orchestrator import run_experiment
from armimp_common import qos
from armimp_common.errors import GraphError
from armimp_common.executor import Spinner
from armimp_common.topics import NS_PER_S, PERIOD
from armimp_sim.simulator import SimulatedRig
from benchmarks import ping_pong
from benchmarks.disturbance import disturbance, loop_times, stolen_time
from benchmarks.tick_parts import TickParts, tick_parts

Processes = Literal["separate", "composed"]

RUNS = 5
"""Experiments in a row for each arrangement; each has to be fast enough and lose nothing."""
DURATION = 10.0
"""Length of each trial, s."""
RATIO_LIMIT = 1.4
"""Largest cost of a tick of the graph without the plant, in ticks of the bare exchange.

The step of the plant simulates the physics. A real rig does not need it, and a faster graph would
not make it cheaper.
"""
SPEED_LIMITS: Mapping[Processes, float] = {"separate": 2.5, "composed": 8.0}
"""Smallest speed, times real time."""
_PATIENCE = 60.0  # s, longest wait for the bare exchange
_PARAMETERS = "parameters.yaml"


@dataclass(frozen=True, kw_only=True)
class Round:
    """An experiment, and the bare exchanges before and after it, so that both met the same load."""

    bare: float
    """Wall time of a bare exchange, mean of before and after the experiment, s."""
    ticks: Sequence[float]
    """Wall time of a tick in each trial, s."""
    plant: float
    """Wall time of a step of the plant, s."""
    lost: int
    """Number of samples lost."""
    loops: Sequence[float]
    """Wall times of a loop of plain Python, s."""
    stolen: float
    """Number of processors that the host took away, on average."""

    @property
    def ratio(self) -> float:
        """Cost of a tick without the plant, in bare exchanges."""
        return (mean(self.ticks) - self.plant) / self.bare


def time_graph(tell: Callable[[str], None]) -> list[Measured]:
    """Measure both arrangements of the node graph; takes some three minutes.

    Bare exchange and experiment take turns, so that both meet the same machine.

    Parameters
    ----------
    tell : callable
        Told what is being measured.

    Raises
    ------
    GraphError
        If an experiment is not valid or the bare exchange does not come to its end.
    """
    figures: list[Measured] = []
    for processes, limit in SPEED_LIMITS.items():
        rounds: list[Round] = []
        parts: list[TickParts] = []
        tell(f"{processes}, bare exchange")
        before = bare_tick(processes)
        for run in range(RUNS):
            tell(f"{processes}, {run + 1} of {RUNS}")
            stolen, began = stolen_time(), time.monotonic()
            experiment = graph_tick(processes)
            stolen = (stolen_time() - stolen) / (time.monotonic() - began)
            after = bare_tick(processes)
            parts.append(tick_parts(ExperimentConfig(duration=DURATION)))
            plant = parts[-1].plant if experiment.plant is None else experiment.plant
            rounds.append(
                Round(
                    bare=mean((before, after)),
                    ticks=experiment.ticks,
                    plant=plant,
                    lost=experiment.lost,
                    loops=loop_times(),
                    stolen=stolen,
                )
            )
            before = after
        figures += graph_figures(processes, rounds, parts, limit)
    return figures


def graph_figures(
    processes: Processes, rounds: Sequence[Round], parts: Sequence[TickParts], limit: float
) -> list[Measured]:
    """What was measured of one arrangement of the nodes, and what follows from it.

    Parameters
    ----------
    processes : "separate" or "composed"
    rounds : what was measured, in turn
    parts : parts of a tick without ROS
    limit : smallest speed, times real time
    """
    graph = [tick for one in rounds for tick in one.ticks]
    speeds = [PERIOD / tick for tick in graph]
    floor, tick = median(one.bare for one in rounds), median(graph)
    plant = median(one.plant for one in rounds)
    law, codecs, recording = (
        median(getattr(one, name) for one in parts) for name in ("law", "codecs", "recording")
    )
    # As processes of their own, sim and controller do not wait for the recorder.
    known = floor + plant + law + codecs + (recording if processes == "composed" else 0.0)
    shares = {
        "bare exchange of the messages": floor,
        "experiment": tick,
        "step of the plant": plant,
        "control law and safety limiter": law,
        "encoding and decoding": codecs,
        "recording": recording,
        "all the rest": tick - known,
    }
    return [
        *(
            Measured(label=f"{processes}: {label}", value=1e6 * value, unit="µs per tick")
            for label, value in shares.items()
        ),
        Measured(
            label=f"{processes}: without plant, over bare exchange",
            value=median(one.ratio for one in rounds),
            limit=RATIO_LIMIT,
        ),
        Measured(label=f"{processes}: with plant, over bare exchange", value=tick / floor),
        Measured(
            label=f"{processes}: real time over speed, slowest of {len(speeds)} trials",
            value=1.0 / min(speeds),
            limit=1.0 / limit,
        ),
        Measured(
            label=f"{processes}: lost samples of {len(speeds)} trials",
            value=sum(one.lost for one in rounds),
            limit=0,
        ),
        Measured(
            label=f"{processes}: plain Python beside, median over fastest",
            value=disturbance([took for one in rounds for took in one.loops]),
        ),
        Measured(
            label=f"{processes}: taken away by the host, in the worst of {len(rounds)} runs",
            value=max(one.stolen for one in rounds),
            unit="processors",
        ),
    ]


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """What an experiment took."""

    ticks: Sequence[float]
    """Wall time of a tick in each trial, s."""
    plant: float | None
    """Wall time of a step of the plant, s; None if that is another process's."""
    lost: int
    """Number of samples lost."""


def graph_tick(processes: Processes) -> Experiment:
    """Run an experiment with full recording.

    Raises
    ------
    GraphError
        If the experiment is not valid for another reason than lost samples.
    """
    with tempfile.TemporaryDirectory() as folder, _timed_steps() as steps:
        config = ExperimentConfig(duration=DURATION, processes=processes)
        summary = run_experiment(config, Path(folder) / "out").summary
    lost = sum(trial.lost for trial in summary.trials)
    # Lost samples are a figure of their own, and no reason to give up.
    if not (summary.valid or lost):
        raise GraphError(f"the experiment is not valid: {summary.faults[0]}")
    return Experiment(
        ticks=[PERIOD / trial.rtf for trial in summary.trials],
        plant=mean(steps) / NS_PER_S if steps else None,
        lost=lost,
    )


@contextmanager
def _timed_steps() -> Iterator[list[int]]:
    """Record the wall time of each step of a simulated rig in this process, ns.

    In a loop of their own, steps would find warm caches and another load of the machine, so their
    time would not be the one to be subtracted from that of a tick.
    """
    plain = SimulatedRig.step
    took: list[int] = []

    def step(rig: SimulatedRig, command: Sequence[float]) -> None:
        began = time.perf_counter_ns()
        plain(rig, command)
        took.append(time.perf_counter_ns() - began)

    SimulatedRig.step = step  # type: ignore[method-assign, assignment]
    try:
        yield took
    finally:
        SimulatedRig.step = plain  # type: ignore[method-assign]


def bare_tick(processes: Processes, exchanges: int = 20_000) -> float:
    """Wall time of one bare exchange, s."""
    with tempfile.TemporaryDirectory() as folder, GraphContext() as graph:
        took: list[int] = []
        watcher = Node("watcher", context=graph.context, use_global_arguments=False)

        def on_result(message: UInt64) -> None:
            took.append(message.data)

        watcher.create_subscription(UInt64, ping_pong.TOOK, on_result, qos.LATCHED)
        parameters = {"joints": 2, "exchanges": exchanges}
        with Spinner([watcher]) as spinner:
            nodes = _bare_nodes(processes, graph.context, spinner, parameters, Path(folder))
            deadline = time.monotonic() + _PATIENCE

            def over() -> bool:
                return bool(took or nodes.dead()) or time.monotonic() > deadline

            try:
                spinner.spin(over)
            finally:
                nodes.close()
                spinner.remove_node(watcher)
                watcher.destroy_node()
        if not took:
            raise GraphError("the bare exchange of messages did not come to its end")
        return took[0] / NS_PER_S / exchanges


class _ComposedBare(NodeGroup):
    """The bare nodes in this process."""

    def __init__(self, context: Context, spinner: Spinner, file: Path) -> None:
        arguments = ["--ros-args", "--params-file", str(file)]
        self._spinner = spinner
        self._nodes: list[Node] = []
        for bare in ping_pong.CLASSES.values():
            node = bare(context=context, cli_args=arguments, use_global_arguments=False)
            self._nodes.append(node)
            spinner.add_node(node)

    def close(self) -> Sequence[str]:
        """Destroy the nodes."""
        for node in self._nodes:
            self._spinner.remove_node(node)
            node.destroy_node()
        return ()


def _bare_nodes(
    processes: Processes,
    context: Context,
    spinner: Spinner,
    parameters: Mapping[str, Any],
    folder: Path,
) -> NodeGroup:
    file = folder / _PARAMETERS
    file.write_text(yaml.safe_dump({"/**": {"ros__parameters": dict(parameters)}}))
    if processes == "composed":
        return _ComposedBare(context, spinner, file)
    modules = {name: (ping_pong.__name__, name) for name in ping_pong.NAMES}
    return SeparateNodes(file, folder / "logs", modules)
