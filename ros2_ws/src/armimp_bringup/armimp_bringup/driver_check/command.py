"""``armimp check-driver``: options, table, exit status."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from armimp_bringup.driver_check.findings import Finding, Verdict, failures, report
from armimp_common.contract import SIM_NODE
from armimp_common.errors import ConfigurationError

_COLOURS = {Verdict.PASS: "green", Verdict.FAIL: "bold red", Verdict.NOT_CHECKED: "dim"}


def check_driver(
    *,
    joints: int | None,
    joint_names: Sequence[str],
    node: str | None,
    domain_id: int | None,
    duration: float,
    move: bool,
    torque: float,
    as_json: bool,
) -> int:
    """Judge a running driver, print the findings, and return the exit status.

    Raises
    ------
    ConfigurationError
        If an option is wrong.
    GraphError
        If there is no driver, or it is in use.
    """
    from armimp_bringup.driver_check.judge import judge
    from armimp_bringup.driver_check.probe import CheckOptions, probe
    from armimp_bringup.external import external_domain

    if not 1.0 <= duration <= 3600.0:
        raise ConfigurationError(f"--duration: {duration:g} is not within 1 to 3600 s")
    if not (math.isfinite(torque) and torque > 0.0):
        raise ConfigurationError(f"--torque: {torque:g} N·m is not above 0")
    options = CheckOptions(
        joints=expected_joints(joints, joint_names),
        node=node or SIM_NODE,
        duration=duration,
        move=move,
        torque=torque,
    )
    findings = judge(probe(options, external_domain(domain_id)))
    if as_json:
        print(json.dumps(report(findings), ensure_ascii=False))
    else:
        print_findings(findings)
    return 1 if failures(findings) else 0


def expected_joints(joints: int | None, names: Sequence[str]) -> tuple[str, ...]:
    """Names that are expected: the given ones, else those of a preset, by default two joints.

    Raises
    ------
    ConfigurationError
        If both are given, or a name is doubled, or there is no such preset.
    """
    from armimp_sim.presets import JOINT_NAMES

    if names:
        if joints is not None:
            raise ConfigurationError("--joints and --joint are two ways to say the same: give one")
        if len(set(names)) < len(names) or not all(names):
            raise ConfigurationError(f"--joint: names are not distinct: {', '.join(names)}")
        return tuple(names)
    count = 2 if joints is None else joints
    if count not in JOINT_NAMES:
        raise ConfigurationError(
            f"--joints: {count} is not within {min(JOINT_NAMES)} to {max(JOINT_NAMES)}"
        )
    return JOINT_NAMES[count]


def print_findings(findings: Sequence[Finding], console: Console | None = None) -> None:
    """Print a table of all findings, and the verdict."""
    out = console if console is not None else Console(soft_wrap=True)
    table = Table(box=SIMPLE_HEAD)
    for column in ("check", "", "found", "limit"):
        table.add_column(column)
    for finding in findings:
        colour = _COLOURS[finding.verdict]
        # What a driver has put into its messages is no markup.
        cells = (escape(text) for text in (finding.figure, finding.limit))
        table.add_row(escape(finding.check), f"[{colour}]{finding.verdict.value}[/]", *cells)
    out.print(table)
    failed = failures(findings)
    left = sum(finding.verdict is Verdict.NOT_CHECKED for finding in findings)
    if failed:
        out.print(f"[bold red]{len(failed)} of {len(findings)} checks failed[/]; {left} not made")
    else:
        out.print(f"[bold]no check failed[/]; {left} of {len(findings)} not made")
