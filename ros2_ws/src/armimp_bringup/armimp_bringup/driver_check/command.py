"""``armimp check-driver``: its question, table and exit status."""

from __future__ import annotations

import json
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from armimp_bringup.config import CheckOptions
from armimp_bringup.driver_check import Finding, Outcome, Record
from armimp_bringup.driver_check.checker import probe
from armimp_bringup.driver_check.rules import judge
from armimp_bringup.graph import external_domain
from armimp_common.errors import ConfigurationError

_COLOURS = {
    Outcome.PASS: "green",
    Outcome.FAIL: "bold red",
    Outcome.INCONCLUSIVE: "yellow",
    Outcome.NOT_CHECKED: "dim",
}


def check_driver(options: CheckOptions, *, domain_id: int | None, yes: bool, as_json: bool) -> int:
    """Judge a running driver, print the findings, and return the exit status.

    Raises
    ------
    ConfigurationError
        If the rig may not be moved.
    GraphError
        If there is no driver, or it is in use.
    """
    domain = external_domain(domain_id)
    if options.move and not yes:
        ask(options, domain)
    record = probe(options, domain)
    findings = judge(record)
    content = report(findings, record, options, domain)
    if as_json:
        print(json.dumps(content))
    else:
        print_findings(findings, content)
    return 0 if content["passed"] else 1


def ask(options: CheckOptions, domain: int) -> None:
    """Ask whether the rig may be moved.

    Raises
    ------
    ConfigurationError
        If nobody is there to be asked, or the answer is no.
    """
    if not sys.stdin.isatty():
        raise ConfigurationError("--move: there is nobody to ask; --yes says that it is safe")
    # Not on standard output, which may have to be JSON.
    print(
        f"--move lets {options.node} (ROS domain {domain}) push each joint"
        f" ({', '.join(options.joints)}) with {options.torque:g} N·m, again and again, for about a"
        " minute.\n"
        "Nobody may be in the rig, nothing may be in its way within"
        f" {options.most_motion:g} rad of where each joint is,\n"
        "and the switch that cuts the power of the drives must be at hand.",
        file=sys.stderr,
    )
    print("Type 'yes' to go on: ", end="", file=sys.stderr, flush=True)
    if sys.stdin.readline().strip().lower() != "yes":
        raise ConfigurationError("--move: not without a yes")


def report(
    findings: Sequence[Finding], record: Record, options: CheckOptions, domain: int
) -> dict[str, Any]:
    """Return what ``--json`` prints."""
    outcomes = Counter(finding.outcome for finding in findings)
    count = {one.name.lower(): outcomes[one] for one in Outcome}
    return {
        "schema": 1,
        "passed": not count["fail"] and not count["inconclusive"],
        **count,
        "findings": [asdict(finding) for finding in findings],
        "lifecycle": record.lifecycle,
        "domain_id": domain,
        "options": options.model_dump(mode="json"),
    }


def print_findings(findings: Sequence[Finding], count: Mapping[str, Any]) -> None:
    """Print a table of all findings, and how many had each outcome."""
    out = Console(soft_wrap=True)
    table = Table(box=SIMPLE_HEAD)
    for column in ("check", "", "found", "limit"):
        table.add_column(column)
    for finding in findings:
        colour = _COLOURS[finding.outcome]
        # Text from the messages of a driver must not be taken for markup.
        cells = (escape(text) for text in (finding.figure, finding.limit))
        table.add_row(escape(finding.check), f"[{colour}]{finding.outcome.value}[/]", *cells)
    out.print(table)
    failed, unsure = count["fail"], count["inconclusive"]
    words = f"{failed} of {len(findings)} checks failed" if failed else "no check failed"
    words = f"[bold{' red' if failed else ''}]{words}[/]"
    if unsure:
        words += f", [yellow]{unsure} inconclusive[/]"
    out.print(f"{words}; {count['not_checked']} not made")
