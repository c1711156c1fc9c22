"""From a recording to findings: the whole judgement of a driver, without ROS."""

from __future__ import annotations

from armimp_bringup.driver_check.contract_rules import judge_contract
from armimp_bringup.driver_check.findings import Finding
from armimp_bringup.driver_check.limits import Limits
from armimp_bringup.driver_check.move_rules import judge_moves
from armimp_bringup.driver_check.samples import Record
from armimp_bringup.driver_check.stream_rules import judge_streams
from armimp_bringup.driver_check.timing_rules import judge_timing


def judge(record: Record, limits: Limits | None = None) -> list[Finding]:
    """Judge a driver against section 10 of docs/interfaces.md.

    Parameters
    ----------
    record : Record
        What it did.
    limits : Limits, optional
        What it is held to.
    """
    limits = limits or Limits()
    return [
        *judge_contract(record),
        *judge_streams(record, limits),
        *judge_timing(record, limits),
        *judge_moves(record, limits),
    ]
