"""The command ``armimp``.

Exit status: 0 valid result, 1 run or data invalid, 2 wrong usage, 130 interrupted without a result.
"""

from __future__ import annotations

import atexit
import inspect
import logging
import os
import resource
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import datetime
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, NoReturn, TypeVar

import typer
from pydantic import BaseModel, ValidationError
from typer.exceptions import TyperException

from armimp_bringup.config import (
    CheckOptions,
    Declared,
    ExperimentConfig,
    checked,
    load_config,
    prepare_directory,
)
from armimp_bringup.terminal import Display, display, repair_streams, say
from armimp_common.errors import ArmimpError, ConfigurationError, GraphError, InterruptionError
from armimp_common.schema import descriptions

_FunctionT = TypeVar("_FunctionT", bound=Callable[..., Any])
_MOST_CHOICES = 10
_TYPES: dict[str, Any] = {
    "integer": int,
    "number": float,
    "string": str,
    "boolean": bool,
    "array": list[str],
}
_OPEN_FILES = 64
"""Number of open files that a process must be permitted; a run of two joints has at most 26."""
_INTERRUPTED = 130
"""Exit status that shells report for a program ended by SIGINT; typer uses it, too."""
app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Measure the multi-joint mechanical impedance of a human arm.",
)

_Bags = Annotated[
    list[Path],
    typer.Argument(
        help="Directories of runs, rosbag2 directories (or a folder of them), .mcap or .db3 files."
    ),
]
_AllowGaps = Annotated[
    bool, typer.Option("--allow-gaps", help="Use the intact parts of trials that lost samples.")
]
_Out = Annotated[
    Path | None, typer.Option("--out", help="New directory for the results.", show_default="none")
]
_NewDirectory = Annotated[
    Path | None,
    typer.Option("--out", help="New directory for the results.", show_default="results/NAME-TIME"),
]
_Json = Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")]
_Config = Annotated[
    Path | None,
    typer.Option(
        help="YAML file with options of the experiment, and with parameters of the nodes."
    ),
]
_DomainId = Annotated[
    int | None,
    typer.Option(
        help="ROS domain, 0 to 100; by default one that is free, or ROS_DOMAIN_ID if others have "
        "started the nodes."
    ),
]


def options_of(model: type[BaseModel], *names: str) -> Callable[[_FunctionT], _FunctionT]:
    """Give a command an option for each of the named fields of a model, by default for all.

    Help, default and choices are those of the field; fields whose type no option can have are left
    out. The command gets None for an option that is not given, so that the value of a configuration
    file prevails over the default.
    """
    properties, described = model.model_json_schema()["properties"], descriptions(model)
    made = [_option(name, properties[name], described[name]) for name in names or properties]

    def decorate(function: _FunctionT) -> _FunctionT:
        signature = inspect.signature(function, eval_str=True)
        own = [
            one.replace(kind=inspect.Parameter.KEYWORD_ONLY)
            for one in signature.parameters.values()
            if one.kind is not inspect.Parameter.VAR_KEYWORD
        ]
        options = [one for one in made if one is not None]
        there = {one.name for one in options}
        parameters = [*options, *(one for one in own if one.name not in there)]
        setattr(function, "__signature__", signature.replace(parameters=parameters))  # noqa: B010
        return function

    return decorate


def _option(name: str, schema: dict[str, Any], described: str) -> inspect.Parameter | None:
    default = schema.get("default")
    schema = {**schema, **next(iter(schema.get("anyOf", ())), {})}  # the first is not null
    kind: Any = _TYPES.get(schema["type"])
    if kind is None:
        return None
    choices = schema.get("enum", [])
    if kind is int and schema.get("maximum", 1e9) - schema.get("minimum", 0) <= _MOST_CHOICES:
        choices = range(schema["minimum"], schema["maximum"] + 1)
    # The option of a list takes one value each time it is given.
    flag = name.removesuffix("s") if isinstance(default, list) else name
    shown: bool | str = False
    if isinstance(default, list):
        shown = " and ".join(default)
    elif default not in (None, "", False):
        shown = f"{default:g}" if isinstance(default, float) else str(default)
    option = typer.Option(
        f"--{flag.replace('_', '-')}",
        help=described,
        show_default=shown,
        autocompletion=lambda: [str(one) for one in choices],
    )
    annotation: Any = Annotated[kind | None, option]
    return inspect.Parameter(
        name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=annotation
    )


def _print_version(wanted: bool) -> None:
    if wanted:
        from armimp_common.versions import software

        here = software()
        print(f"armimp {here['versions']['armimp']} ({here['git_revision']})")
        raise typer.Exit


@app.callback()
def _armimp(
    _: Annotated[
        bool,
        typer.Option(
            "--version",
            "-V",
            callback=_print_version,
            is_eager=True,
            help="Print the version and exit.",
        ),
    ] = False,
) -> None:
    pass


@app.command()
@options_of(ExperimentConfig)
def run(
    config: _Config = None,
    out: _NewDirectory = None,
    domain_id: _DomainId = None,
    json: _Json = False,
    **options: Any,
) -> int:
    """Run one trial for each joint through the node graph."""
    with Display() as display:
        display.phase("starting")
        from armimp_bringup.orchestrator import run_experiment
        from armimp_bringup.presentation import Stopwatch, present
        from armimp_common.compiled import on_compiling
        from armimp_common.process import stop_on_signals
        from armimp_common.status import Phase

        on_compiling(tell_of_compiling)
        settings = load_config(config, options)
        directory = out or _new_directory("run")
        stopwatch = Stopwatch()

        def note(entered: Phase) -> None:
            stopwatch.note(entered)
            if entered is Phase.DONE:
                display.complete("estimating")

        with stop_on_signals() as stopped:
            result = run_experiment(
                settings,
                directory,
                domain_id=domain_id,
                on_progress=display.show,
                on_phase=note,
                interrupted=stopped,
            )
            display.close()
            return present(result, directory, as_json=json, stopwatch=stopwatch)


@app.command()
@options_of(Declared)
@options_of(ExperimentConfig, "estimators")
def estimate(
    bags: _Bags,
    namespace: Annotated[
        str | None, typer.Option(help="Namespace of the topics; by default found by itself.")
    ] = None,
    allow_gaps: _AllowGaps = False,
    out: _Out = None,
    json: _Json = False,
    estimators: list[str] | None = None,
    **options: Any,
) -> int:
    """Estimate the impedance from bags of all joints' trials."""
    with Display() as display:
        display.phase("starting")
        from armimp_bringup.offline_estimate import estimate_bags
        from armimp_bringup.presentation import present
        from armimp_common.process import stop_on_signals

        declared = checked(Declared, options)
        if out is not None:
            prepare_directory(out)
        result = estimate_bags(
            bags,
            tuple(estimators or ()),
            namespace=namespace,
            allow_gaps=allow_gaps,
            declared=declared,
        )
        display.close()
        with stop_on_signals():  # too late to interrupt: there is a result
            for note in result.notes:
                say(f"note: {note}")
            if out is not None:
                result.write(out)
            return present(result, out, as_json=json)


@app.command()
@options_of(ExperimentConfig, "estimators")
def replay(
    bags: _Bags,
    allow_gaps: _AllowGaps = False,
    out: _Out = None,
    domain_id: _DomainId = None,
    json: _Json = False,
    estimators: list[str] | None = None,
) -> int:
    """Play bags into a live estimator node."""
    with Display() as display:
        display.phase("starting")
        from armimp_bringup.presentation import present
        from armimp_bringup.replay import replay_bags
        from armimp_common.process import stop_on_signals

        with stop_on_signals() as stopped:
            result = replay_bags(
                bags,
                tuple(estimators or ()),
                out,
                allow_gaps=allow_gaps,
                domain_id=domain_id,
                interrupted=stopped,
            )
            display.close()
            return present(result, out, as_json=json)


@app.command()
@options_of(
    ExperimentConfig,
    *("joints", "perturbation_kind", "internal_model", "as_in_paper", "duration", "estimators"),
)
def reproduce(
    out: _NewDirectory = None,
    only: Annotated[
        list[str] | None,
        typer.Option(
            help="Levels, as in friction=0+3,resolution=0; more than once: all of these. "
            "The levels are those of `armimp run --help`.",
            show_default="all 48 conditions",
        ),
    ] = None,
    seeds: Annotated[str, typer.Option(help="Seeds, as in 77 or 0:10 or 1,5,10:20.")] = "0",
    workers: Annotated[
        int | None,
        typer.Option(min=1, help="Processes.", show_default="one for each core"),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            help="Scheduler of a dask cluster to run on: tcp://host:port.",
            show_default="none, processes of this machine",
        ),
    ] = None,
    config: Annotated[
        Path | None, typer.Option(help="YAML file; its levels and seed do not count.")
    ] = None,
    figures: Annotated[bool, typer.Option(help="Draw the figures.")] = True,
    json: _Json = False,
    **options: Any,
) -> int:
    """Reproduce the paper's study, under all its conditions."""
    with Display() as display:
        display.phase("starting")
        from armimp_bringup.study import select_conditions
        from armimp_bringup.study.engine import cluster, processes
        from armimp_bringup.study.study import present_verdict, run_study
        from armimp_common.compiled import on_compiling
        from armimp_estimation.summary import OriginSummary

        on_compiling(tell_of_compiling)
        directory = out or _new_directory("study")
        settings = load_config(config, options)
        conditions = select_conditions(only or (), seeds)
        if scheduler is not None and workers is not None:
            raise ConfigurationError(
                "--workers is for processes of this machine, a --scheduler has its own"
            )
        backend = processes(workers) if scheduler is None else cluster(scheduler)
        origin = OriginSummary.of(sys.argv)
        verdict = run_study(
            settings, conditions, directory, backend, figures=figures, origin=origin
        )
        display.close()
        return present_verdict(verdict, directory, as_json=json)


@app.command()
def bench(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="[NAME]...", help="speed or jitter.", show_default="both"),
    ] = None,
    json: _Json = False,
) -> int:
    """Measure speed and jitter of the graph on this machine."""
    from armimp_bringup.bench import bench as run_bench

    return run_bench(names or (), as_json=json)


@app.command()
@options_of(CheckOptions)
def check_driver(
    domain_id: Annotated[
        int | None,
        typer.Option(help="ROS domain of the driver; by default ROS_DOMAIN_ID, else 0."),
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask whether --move is safe.")] = False,
    json: _Json = False,
    **options: Any,
) -> int:
    """Judge a running driver by docs/interfaces.md."""
    from armimp_bringup.driver_check.command import check_driver as judge_driver

    given = {name: value for name, value in options.items() if value is not None}
    return judge_driver(checked(CheckOptions, given), domain_id=domain_id, yes=yes, as_json=json)


def main(
    arguments: Sequence[str] | None = None, program: typer.Typer = app, name: str = "armimp"
) -> int:
    """Run a command line; every error that a user can cause is reported in one line."""
    try:
        _require_open_files()
        status = program(args=arguments, prog_name=name, standalone_mode=False)
    except TyperException as error:
        message = _complaint(error)
        if message.startswith("Usage: "):
            # Without arguments typer shows the help, which has many lines.
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
    except ImportError:
        if find_spec("rclpy") is None:
            say("armimp: this needs ROS, which is not installed: pip install 'armimp[ros]'")
            return 1
        raise
    except BrokenPipeError:
        # The reader of the output has closed it, as `head` does.
        sys.stderr.close()
        return 1
    except OSError as error:
        place = "" if error.filename is None else f"{error.filename}: "
        say(f"armimp: {place}{error.strerror or error}")
        return 1
    if status == _INTERRUPTED:
        say("armimp: interrupted")
    return status if isinstance(status, int) else 0


def _complaint(error: TyperException) -> str:
    message = error.format_message()
    if isinstance(error.__cause__, ValidationError):
        message += f", got {error.__cause__.errors()[0]['input']!r:.60}"
    return message


def tell_of_compiling() -> None:
    """Show on the open display that code is being compiled."""
    display().phase("compiling, once for this version")


def _require_open_files() -> None:
    """Raise the limit of open files to the number needed; GraphError if that is not permitted."""
    limit, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    if 0 <= limit < _OPEN_FILES:
        if 0 <= most < _OPEN_FILES:
            raise GraphError(
                f"{most} open files are permitted (ulimit -n), and {_OPEN_FILES} are needed"
            )
        resource.setrlimit(resource.RLIMIT_NOFILE, (_OPEN_FILES, most))


def _new_directory(what: str) -> Path:
    return Path("results") / f"{what}-{datetime.now():%Y%m%d-%H%M%S}"


def program() -> NoReturn:
    """Run the command line as a process of its own, and exit without finalising the interpreter.

    Finalising would take half a second, as everything that was imported is torn down.
    """
    repair_streams()
    # Without a home directory matplotlib keeps its cache elsewhere, with a long warning.
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    status = main()
    atexit._run_exitfuncs()
    try:
        sys.stdout.flush()
        sys.stderr.flush()
    except (BrokenPipeError, ValueError):  # the reader of the output has closed it
        status = status or 1
    except OSError as error:
        status = status or 1
        with suppress(OSError):
            say(f"armimp: the output cannot be written: {error.strerror}")
    os._exit(status)
