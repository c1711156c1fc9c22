"""The command ``armimp``.

Exit status: 0 valid result, 1 run or data invalid, 2 wrong usage, 130 interrupted without a result.
"""

from __future__ import annotations

import atexit
import math
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import datetime
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer
from typer.exceptions import TyperException

from armimp_bringup.resources import require_open_files
from armimp_bringup.terminal import Display, phase, repair_streams, say
from armimp_common.errors import ArmimpError, ConfigurationError, InterruptionError

_INTERRUPTED = 130
"""What shells make of a program that SIGINT has ended; typer's own status for it, too."""
_ESTIMATOR_NAMES = ("welch_siso", "welch_full", "lpm_full", "direct")

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Measure the multi-joint mechanical impedance of a human arm.",
)


def _print_version(wanted: bool) -> None:
    if wanted:
        from armimp_common.versions import git_revision, versions

        print(f"armimp {versions()['armimp']} ({git_revision()})")
        raise typer.Exit


@app.callback()
def _armimp(
    _: Annotated[
        bool,
        typer.Option("--version", "-V", callback=_print_version, is_eager=True, help="Tell it."),
    ] = False,
) -> None:
    pass


def _choices(*values: object) -> Callable[[], list[str]]:
    """What a shell offers for an option."""
    return lambda: [str(value) for value in values]


def _default(text: str) -> Any:
    """The default that a help page shows where None leaves it to a configuration file."""
    return {"show_default": text}


_Bags = Annotated[
    list[Path],
    typer.Argument(
        help="Directories of runs, rosbag2 directories (or a folder of them), .mcap or .db3 files."
    ),
]
_Estimators = Annotated[
    list[str] | None,
    typer.Option(
        "--estimator",
        help=f"Estimator: {', '.join(_ESTIMATOR_NAMES)}. May be given more than once.",
        autocompletion=_choices(*_ESTIMATOR_NAMES),
        **_default("welch_siso and lpm_full"),
    ),
]
_AllowGaps = Annotated[
    bool, typer.Option("--allow-gaps", help="Use the intact parts of trials that lost samples.")
]
_Trust = Annotated[
    bool, typer.Option("--trust", help="Lift the limits on what a bag may hold for its size.")
]
_TorqueDelay = Annotated[
    float | None,
    typer.Option(
        help="How late torque readings are, s, negative if they are early.",
        **_default("as recorded with the bags, else fitted"),
    ),
]
_TorqueTiming = Annotated[
    str | None,
    typer.Option(
        help="When torques are read: before, after, mid, mean or simultaneous.",
        autocompletion=_choices("before", "after", "mid", "mean", "simultaneous"),
        **_default("as recorded with the bags, else found"),
    ),
]
_TorqueUncertainty = Annotated[
    float | None,
    typer.Option(
        help="Standard error of what is told of that, s.", **_default("20 µs where it is told")
    ),
]
_Rate = Annotated[
    float | None,
    typer.Option(
        help="Sampling rate, Hz, if an uncustomary one is right.", **_default("found by itself")
    ),
]
_Out = Annotated[
    Path | None, typer.Option("--out", help="New directory for the results.", show_default="none")
]
_NewDirectory = Annotated[
    Path | None,
    typer.Option("--out", help="New directory for the results.", **_default("results/NAME-TIME")),
]
_Json = Annotated[bool, typer.Option("--json", help="Print summary.json instead of tables.")]
_Config = Annotated[
    Path | None,
    typer.Option(help="YAML file with any of these options, and with parameters of the nodes."),
]
_Joints = Annotated[
    int | None,
    typer.Option(
        help="Joints of the preset arm, 1 to 7; 2 is the paper's arm of shoulder and elbow.",
        autocompletion=_choices(*range(1, 8)),
        **_default("2"),
    ),
]
_Duration = Annotated[
    float | None, typer.Option(help="Length of each trial, s; 2 to 9000.", **_default("50"))
]
_DomainId = Annotated[
    int | None, typer.Option(help="ROS domain, 0 to 232.", **_default("one that is free"))
]
_Workers = Annotated[
    int | None, typer.Option(help="Number of threads.", **_default("one for each core"))
]


@app.command()
def run(  # noqa: PLR0913, PLR0917 (typer makes an option of each)
    config: _Config = None,
    friction: Annotated[
        int | None,
        typer.Option(
            help="Level of joint friction: 0 none; 1, 2, 3 Coulomb friction of 0.4, 1, 2 N·m.",
            autocompletion=_choices(0, 1, 2, 3),
            **_default("3"),
        ),
    ] = None,
    resolution: Annotated[
        int | None,
        typer.Option(
            help="Level of sensor resolution: 0 exact; 1, 2, 3 encoder steps of 360°/204800, "
            "/102400, /51200 and torque steps of 5, 10, 20 mN·m.",
            autocompletion=_choices(0, 1, 2, 3),
            **_default("3"),
        ),
    ] = None,
    perturbation: Annotated[
        int | None,
        typer.Option(
            help="Level of the perturbing torque: 1, 2, 3 peaks of 3, 6, 9 N·m at the shoulder and "
            "1.8, 3.6, 5.4 N·m at the elbow.",
            autocompletion=_choices(1, 2, 3),
            **_default("3"),
        ),
    ] = None,
    duration: _Duration = None,
    seed: Annotated[
        int | None, typer.Option(help="Seed of all random signals.", **_default("1"))
    ] = None,
    mode: Annotated[
        str | None,
        typer.Option(
            help="How time passes: lockstep (as fast as the machine, repeatable) or realtime "
            "(1 kHz by the wall clock).",
            autocompletion=_choices("lockstep", "realtime"),
            **_default("lockstep"),
        ),
    ] = None,
    processes: Annotated[
        str | None,
        typer.Option(
            help="Where the nodes live: composed (in one process), separate (one for each) or "
            "external (started by others).",
            autocompletion=_choices("composed", "separate", "external"),
            **_default("composed; separate in realtime"),
        ),
    ] = None,
    priority: Annotated[
        int | None,
        typer.Option(
            help="SCHED_FIFO priority of rig and controller in realtime, 1 to 99; 0: ordinary.",
            **_default("0"),
        ),
    ] = None,
    joints: _Joints = None,
    estimator: _Estimators = None,
    target_error: Annotated[
        str | None,
        typer.Option(
            help="End a trial once the standard errors of M, B, K are below: 2% or 0.02.",
            **_default("never"),
        ),
    ] = None,
    torque_delay: Annotated[
        float | None,
        typer.Option(
            help="How late torque readings are, s, for the estimates to correct.",
            **_default("as simulated"),
        ),
    ] = None,
    out: _NewDirectory = None,
    domain_id: Annotated[
        int | None,
        typer.Option(
            help="ROS domain, 0 to 232.",
            **_default("one that is free; with external nodes ROS_DOMAIN_ID"),
        ),
    ] = None,
    json: _Json = False,
) -> int:
    """Run the experiment through the node graph: one trial for each joint, then the result."""
    share = None if target_error is None else _share(target_error)
    with Display() as display:
        display.phase("starting")
        from armimp_common.compiled import on_compiling, spare_linear_algebra

        spare_linear_algebra()
        on_compiling(tell_of_compiling)
        from armimp_bringup.config import load_config
        from armimp_bringup.orchestrator import run_experiment
        from armimp_bringup.presentation import Stopwatch, present
        from armimp_common.executor import stop_on_signals
        from armimp_common.status import Phase

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
                "target_error": share,
                "torque_delay": torque_delay,
            },
        )
        directory = out if out is not None else _new_directory("run")
        stopwatch = Stopwatch()

        def note(entered: Phase) -> None:
            stopwatch.note(entered)
            if entered is Phase.DONE:
                display.complete("estimating")

        with stop_on_signals() as stopped:
            summary = run_experiment(
                settings,
                directory,
                domain_id=domain_id,
                on_progress=display.show,
                on_phase=note,
                interrupted=stopped,
            )
            display.close()
            return present(summary, directory, as_json=json, stopwatch=stopwatch)


@app.command()
def estimate(  # noqa: PLR0913, PLR0917 (typer makes an option of each)
    bags: _Bags,
    estimator: _Estimators = None,
    namespace: Annotated[
        str | None, typer.Option(help="Namespace of the topics.", **_default("found by itself"))
    ] = None,
    allow_gaps: _AllowGaps = False,
    torque_timing: _TorqueTiming = None,
    torque_delay: _TorqueDelay = None,
    torque_uncertainty: _TorqueUncertainty = None,
    rate: _Rate = None,
    trust: _Trust = False,
    out: _Out = None,
    json: _Json = False,
) -> int:
    """Estimate the impedance from bags, one trial for each joint among them."""
    with Display() as display:
        display.phase("starting")
        from armimp_bringup.offline_estimate import Declared, estimate_bags
        from armimp_bringup.presentation import present
        from armimp_bringup.resources import prepare_directory
        from armimp_estimation.bags.storage import find_bags

        declared = Declared(
            torque_timing=torque_timing,
            torque_delay=torque_delay,
            torque_uncertainty=torque_uncertainty,
            rate=rate,
        )
        bags = find_bags(bags)
        if out is not None:
            prepare_directory(out)
        conclusion, notes = estimate_bags(
            bags,
            tuple(estimator or ()),
            namespace=namespace,
            allow_gaps=allow_gaps,
            declared=declared,
            trust=trust,
        )
        display.close()
        for note in notes:
            say(f"note: {note}")
        if out is not None:
            conclusion.write(out)
        return present(conclusion.summary, out, as_json=json, bags=bags, namespace=namespace)


@app.command()
def replay(
    bags: _Bags,
    estimator: _Estimators = None,
    allow_gaps: _AllowGaps = False,
    trust: _Trust = False,
    out: _Out = None,
    domain_id: _DomainId = None,
    json: _Json = False,
) -> int:
    """Play bags through the graph into a live estimator node."""
    with Display() as display:
        display.phase("starting")
        from armimp_bringup.presentation import present
        from armimp_bringup.replay import replay_bags
        from armimp_common.executor import stop_on_signals
        from armimp_estimation.bags.storage import find_bags

        bags = find_bags(bags)

        with stop_on_signals() as stopped:
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
            display.close()
            return present(summary, out, as_json=json, bags=bags)


@app.command()
def reproduce(  # noqa: PLR0913, PLR0917 (typer makes an option of each)
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            help="Directory, new or of a study to go on with.",
            **_default("results/study-TIME"),
        ),
    ] = None,
    only: Annotated[
        list[str] | None,
        typer.Option(
            help="Levels, as in friction=0+3,resolution=0; more than once: all of these. "
            "The levels are those of `armimp run --help`.",
            **_default("all 48 conditions"),
        ),
    ] = None,
    seeds: Annotated[str, typer.Option(help="Seeds, as in 77 or 0:10 or 1,5,10:20.")] = "0",
    workers: _Workers = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            help="Scheduler of a dask cluster to run on: tcp://host:port.",
            **_default("none, threads of this machine"),
        ),
    ] = None,
    config: Annotated[
        Path | None, typer.Option(help="YAML file; its levels and seed do not count.")
    ] = None,
    joints: _Joints = None,
    duration: _Duration = None,
    estimator: _Estimators = None,
    figures: Annotated[bool, typer.Option(help="Draw the figures.")] = True,
    json: Annotated[
        bool, typer.Option("--json", help="Print verdict.json instead of a table.")
    ] = False,
) -> int:
    """Reproduce the paper's study: all levels of friction, resolution and perturbation."""
    with Display() as display:
        display.phase("starting")
        from armimp_bringup.study.command import ReproduceOptions
        from armimp_bringup.study.command import reproduce as run_study
        from armimp_common.compiled import on_compiling

        on_compiling(tell_of_compiling)
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
        list[str] | None,
        typer.Argument(metavar="[NAME]...", help="speed or jitter.", show_default="both"),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")] = False,
) -> int:
    """Measure how fast and how regular the node graph is on this machine."""
    from armimp_bringup.bench import bench as run_bench

    return run_bench(names or (), as_json=json)


@app.command()
def check_driver(  # noqa: PLR0913, PLR0917 (typer makes an option of each)
    domain_id: Annotated[
        int | None, typer.Option(help="ROS domain of the driver.", **_default("ROS_DOMAIN_ID"))
    ] = None,
    joints: _Joints = None,
    joint: Annotated[
        list[str] | None, typer.Option(help="Name of a joint, in the order of commands; repeat.")
    ] = None,
    node: Annotated[str, typer.Option(help="Name of the node.")] = "arm_sim",
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
    from armimp_bringup.driver_check.command import expected_joints
    from armimp_bringup.driver_check.moves import CheckOptions

    options = CheckOptions(
        joints=expected_joints(joints, joint or ()),
        node=node,
        duration=duration,
        move=move,
        torque=torque,
        most=most_motion,
        namespace=namespace,
    )
    return judge_driver(options, domain_id=domain_id, yes=yes, as_json=json)


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
        raise ConfigurationError(f"--target-error: {text!r} is no share such as 2% or 0.02{hint}")
    return share


def tell_of_compiling() -> None:
    """Name that phase on the display that is open."""
    phase("compiling, once for this version")


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
