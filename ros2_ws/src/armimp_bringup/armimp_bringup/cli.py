"""The command ``armimp``.

Exit status: 0 valid result, 1 run or data invalid, 2 wrong usage, 130 interrupted without a result.
"""

from __future__ import annotations

import atexit
import math
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from datetime import datetime
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, NoReturn

import typer
from typer.exceptions import TyperException

from armimp_bringup.resources import require_open_files
from armimp_bringup.say import repair_streams, say
from armimp_common.errors import ArmimpError, ConfigurationError, InterruptionError

_INTERRUPTED = 130
"""What shells make of a program that SIGINT has ended; typer's own status for it, too."""

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="Measure the multi-joint mechanical impedance of a human arm.",
)

_Bags = Annotated[list[Path], typer.Argument(help="rosbag2 directories, .mcap or .db3 files.")]
_Estimators = Annotated[
    list[str] | None,
    typer.Option("--estimator", help="Estimator of the result; may be given more than once."),
]
_AllowGaps = Annotated[
    bool, typer.Option("--allow-gaps", help="Use the intact parts of trials that lost samples.")
]
_Trust = Annotated[
    bool, typer.Option("--trust", help="Lift the limits on what a bag may hold for its size.")
]
_TorqueDelay = Annotated[
    float | None,
    typer.Option(help="How late torque readings are, s, for the estimates to correct."),
]
_Out = Annotated[Path | None, typer.Option("--out", help="New directory for the results.")]
_Json = Annotated[bool, typer.Option("--json", help="Print summary.json instead of tables.")]


@app.command()
def run(  # noqa: PLR0913, PLR0917 (typer makes an option of each)
    config: Annotated[
        Path | None, typer.Option(help="YAML file with any of these options.")
    ] = None,
    friction: Annotated[int | None, typer.Option(help="Friction level, 0 to 3.")] = None,
    resolution: Annotated[int | None, typer.Option(help="Resolution level, 0 to 3.")] = None,
    perturbation: Annotated[int | None, typer.Option(help="Perturbation level, 1 to 3.")] = None,
    duration: Annotated[float | None, typer.Option(help="Length of each trial, s.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of all random signals.")] = None,
    mode: Annotated[str | None, typer.Option(help="How time passes: lockstep or realtime.")] = None,
    processes: Annotated[
        str | None, typer.Option(help="Where the nodes live: composed, separate or external.")
    ] = None,
    priority: Annotated[
        int | None, typer.Option(help="SCHED_FIFO priority of rig and controller in realtime.")
    ] = None,
    joints: Annotated[int | None, typer.Option(help="Joints of the preset arm, 1 to 7.")] = None,
    estimator: _Estimators = None,
    until_error: Annotated[
        str | None,
        typer.Option(help="End a trial once the standard errors of M, B, K are below: 2% or 0.02."),
    ] = None,
    torque_delay: _TorqueDelay = None,
    out: _Out = None,
    domain_id: Annotated[
        int | None,
        typer.Option(help="ROS domain; default: a free one; of external nodes: ROS_DOMAIN_ID."),
    ] = None,
    json: _Json = False,
) -> int:
    """Run the experiment through the node graph: one trial for each joint, then the result."""
    from armimp_common.compiled import spare_linear_algebra

    spare_linear_algebra()
    from armimp_bringup.config import load_config
    from armimp_bringup.display import LiveDisplay
    from armimp_bringup.orchestrator import run_experiment
    from armimp_bringup.presentation import present
    from armimp_bringup.stopwatch import Stopwatch
    from armimp_common.spin import stop_on_signals
    from armimp_estimation.figure_process import FigureProcess

    settings = load_config(
        config,
        {
            "friction": friction,
            "resolution": resolution,
            "perturbation": perturbation,
            "duration": duration,
            "seed": seed,
            "mode": mode,
            "processes": processes,
            "priority": priority,
            "joints": joints,
            "estimators": tuple(estimator) if estimator else None,
            "until_error": None if until_error is None else _share(until_error),
            "torque_delay": torque_delay,
        },
    )
    directory = out if out is not None else _new_directory("run")
    stopwatch = Stopwatch()
    with stop_on_signals() as stopped, LiveDisplay() as display, FigureProcess() as figures:
        if settings.mode == "lockstep":  # in real time, nothing may run beside the experiment
            figures.start()
        summary = run_experiment(
            settings,
            directory,
            domain_id=domain_id,
            on_progress=display.show,
            on_phase=stopwatch.note,
            on_over=lambda: figures.draw(directory),
            interrupted=stopped,
        )
        return present(summary, directory, figures, as_json=json, stopwatch=stopwatch)


@app.command()
def estimate(
    bags: _Bags,
    estimator: _Estimators = None,
    namespace: Annotated[
        str | None, typer.Option(help="Namespace of the topics; default: found by itself.")
    ] = None,
    allow_gaps: _AllowGaps = False,
    torque_delay: _TorqueDelay = None,
    trust: _Trust = False,
    out: _Out = None,
    json: _Json = False,
) -> int:
    """Estimate the impedance from bags, one trial for each joint among them."""
    from armimp_bringup.offline_estimate import estimate_bags
    from armimp_bringup.presentation import present
    from armimp_bringup.resources import prepare_directory
    from armimp_estimation.figure_process import FigureProcess

    if torque_delay is not None and not 0.0 <= torque_delay <= 0.1:
        raise ConfigurationError(f"--torque-delay: {torque_delay} is not within 0 to 0.1 s")
    with FigureProcess() as figures:
        if out is not None:
            prepare_directory(out)
            figures.start()
        conclusion, notes = estimate_bags(
            bags,
            tuple(estimator or ()),
            namespace=namespace,
            allow_gaps=allow_gaps,
            torque_delay=torque_delay,
            trust=trust,
        )
        for note in notes:
            say(f"note: {note}")
        if out is not None:
            conclusion.write(out)
        return present(
            conclusion.summary, out, figures, as_json=json, bags=bags, namespace=namespace
        )


@app.command()
def replay(
    bags: _Bags,
    estimator: _Estimators = None,
    allow_gaps: _AllowGaps = False,
    trust: _Trust = False,
    out: _Out = None,
    domain_id: Annotated[int | None, typer.Option(help="ROS domain; default: a free one.")] = None,
    json: _Json = False,
) -> int:
    """Play bags through the graph into a live estimator node."""
    from armimp_bringup.display import LiveDisplay
    from armimp_bringup.presentation import present
    from armimp_bringup.replay import replay_bags
    from armimp_common.spin import stop_on_signals
    from armimp_estimation.figure_process import FigureProcess

    with stop_on_signals() as stopped, LiveDisplay() as display, FigureProcess() as figures:
        summary = replay_bags(
            bags,
            tuple(estimator or ()),
            out,
            allow_gaps=allow_gaps,
            trust=trust,
            domain_id=domain_id,
            on_progress=display.show,
            interrupted=stopped,
        )
        return present(summary, out, figures, as_json=json, bags=bags)


@app.command()
def reproduce(  # noqa: PLR0913, PLR0917 (typer makes an option of each)
    out: Annotated[
        Path | None, typer.Option("--out", help="Directory, new or of a study to go on with.")
    ] = None,
    only: Annotated[
        list[str] | None,
        typer.Option(help="Levels, as in friction=0+3,resolution=0; more than once: all of these."),
    ] = None,
    seeds: Annotated[str, typer.Option(help="Seeds, as in 77 or 0:10 or 1,5,10:20.")] = "0",
    workers: Annotated[int | None, typer.Option(help="Threads; default: one per core.")] = None,
    scheduler: Annotated[
        str | None, typer.Option(help="Scheduler of a dask cluster to run on: tcp://host:port.")
    ] = None,
    config: Annotated[
        Path | None, typer.Option(help="YAML file; its levels and seed do not count.")
    ] = None,
    joints: Annotated[int | None, typer.Option(help="Joints of the preset arm, 1 to 7.")] = None,
    duration: Annotated[float | None, typer.Option(help="Length of each trial, s.")] = None,
    estimator: _Estimators = None,
    figures: Annotated[bool, typer.Option(help="Draw the figures.")] = True,
    json: Annotated[
        bool, typer.Option("--json", help="Print verdict.json instead of a table.")
    ] = False,
) -> int:
    """Reproduce the paper's study: all levels of friction, resolution and perturbation."""
    from armimp_bringup.study.command import ReproduceOptions
    from armimp_bringup.study.command import reproduce as run_study

    return run_study(
        ReproduceOptions(
            config=config,
            out=out if out is not None else _new_directory("study"),
            only=only or (),
            seeds=seeds,
            workers=workers,
            scheduler=scheduler,
            joints=joints,
            duration=duration,
            estimators=estimator,
            figures=figures,
            json=json,
        )
    )


@app.command()
def bench(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[NAME]...", help="Benchmarks; default: all.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Directory for bench.json.")] = None,
    json: Annotated[
        bool, typer.Option("--json", help="Print bench.json instead of a table.")
    ] = False,
) -> int:
    """Measure how fast this machine is; a target that is missed makes the exit status 1."""
    from armimp_bringup.benchmarks import bench as run_bench

    return run_bench(names or (), out if out is not None else _new_directory("bench"), as_json=json)


@app.command()
def check_driver(  # noqa: PLR0913, PLR0917 (typer makes an option of each)
    domain_id: Annotated[
        int | None, typer.Option(help="ROS domain of the driver; default: ROS_DOMAIN_ID.")
    ] = None,
    joints: Annotated[int | None, typer.Option(help="Joints of the preset arm, 1 to 7.")] = None,
    joint: Annotated[
        list[str] | None, typer.Option(help="Name of a joint, in the order of commands; repeat.")
    ] = None,
    node: Annotated[str | None, typer.Option(help="Name of the node; default: arm_sim.")] = None,
    namespace: Annotated[str, typer.Option(help="Namespace of the driver.")] = "",
    duration: Annotated[float, typer.Option(help="Length of the recording, s.")] = 5.0,
    move: Annotated[
        bool, typer.Option("--move", help="Command torque too: nobody may be in the rig.")
    ] = False,
    torque: Annotated[float, typer.Option(help="How much torque, N·m; at most 20.")] = 1.0,
    most_motion: Annotated[
        float, typer.Option(help="Motion of a joint at which torque is taken away, rad.")
    ] = 0.3,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask whether --move is safe.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
) -> int:
    """Judge a running driver, or the simulator, against the contract of docs/interfaces.md."""
    from armimp_bringup.driver_check.command import check_driver as judge_driver

    return judge_driver(
        joints=joints,
        joint_names=joint or (),
        node=node,
        namespace=namespace,
        domain_id=domain_id,
        duration=duration,
        move=move,
        torque=torque,
        most=most_motion,
        yes=yes,
        as_json=json,
    )


def main(
    arguments: Sequence[str] | None = None, program: typer.Typer = app, name: str = "armimp"
) -> int:
    """Run a command line; every error that a user can cause ends in one line."""
    try:
        require_open_files()
        status = program(args=arguments, prog_name=name, standalone_mode=False)
    except TyperException as error:
        message = error.format_message()
        if message.startswith("Usage: "):
            # Asking for nothing shows the help, which has many lines.
            print(message, file=sys.stderr)
        else:
            say(f"armimp: {message}")
        return 2
    except ArmimpError as error:
        say(f"armimp: {error}")
        if isinstance(error, ConfigurationError):
            return 2
        return _INTERRUPTED if isinstance(error, InterruptionError) else 1
    except (KeyboardInterrupt, typer.Abort):
        status = _INTERRUPTED
    except ImportError as error:
        if find_spec("rclpy") is None:
            say("armimp: this needs ROS, which is not installed: pip install 'armimp[ros]'")
            return 1
        # So compiled modules put it when SIGINT comes while they are imported.
        if not isinstance(error.__cause__ or error.__context__, KeyboardInterrupt):
            raise
        status = _INTERRUPTED
    except BrokenPipeError:
        # Whoever read the output has left, as `head` does.
        sys.stderr.close()
        return 1
    except OSError as error:
        place = "" if error.filename is None else f"{error.filename}: "
        say(f"armimp: {place}{error.strerror or error}")
        return 1
    if status == _INTERRUPTED:
        say("armimp: interrupted")
    return status if isinstance(status, int) else 0


def _share(text: str) -> float:
    """A share such as ``2%`` or ``0.02``.

    Raises
    ------
    ConfigurationError
        If it is none, or as large as the whole.
    """
    percent = text.rstrip().endswith("%")
    try:
        share = float(text.rstrip().removesuffix("%")) / (100.0 if percent else 1.0)
    except ValueError:
        share = math.nan
    if not 0.0 < share < 1.0:
        hint = "" if percent or not share >= 1.0 else f"; did you mean {text.strip()}%?"
        raise ConfigurationError(f"--until-error: {text!r} is no share such as 2% or 0.02{hint}")
    return share


def _new_directory(what: str) -> Path:
    return Path("results") / f"{what}-{datetime.now():%Y%m%d-%H%M%S}"


def program() -> NoReturn:
    """Run the command line as the whole of a process, which ends at once.

    To take everything apart that was imported would take the interpreter half a second.
    """
    repair_streams()
    status = main()
    atexit._run_exitfuncs()
    try:
        sys.stdout.flush()
        sys.stderr.flush()
    except (BrokenPipeError, ValueError):  # whoever read the output has left
        status = status or 1
    except OSError as error:
        status = status or 1
        with suppress(OSError):
            say(f"armimp: the output cannot be written: {error.strerror}")
    os._exit(status)


if __name__ == "__main__":
    program()
