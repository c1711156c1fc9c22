"""docs/drivers.md says what the code does."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from armimp_bringup.config import CheckOptions
from armimp_bringup.driver_check.command import about
from armimp_bringup.driver_check.findings import Rule, Verdict, judged, report
from armimp_bringup.driver_check.record import Ending, Moves, Record
from armimp_bringup.driver_check.rules import judge
from armimp_common.schema import leaves
from armimp_ros2_control.parameters import BridgeParameters

DOCS = Path(__file__).resolve().parents[1] / "docs"


def first_cells(page: str, header: str) -> list[str]:
    """First column of the table with such a first cell of its header, without backticks."""
    text = (DOCS / page).read_text(encoding="utf-8")

    def rows() -> Iterator[str]:
        inside = False
        for line in text.splitlines():
            cells = [cell.strip() for cell in line.strip("|").split("|")]
            if line.startswith(f"| {header} |"):
                inside = True
            elif not line.startswith("|"):
                inside = False
            elif inside and not set(line) <= set("|-: "):
                yield cells[0].replace("`", "")

    return list(rows())


def record() -> Record:
    moves = Moves(stale=Ending(), stop=Ending())
    return Record(joints=("shoulder",), paced=True, endpoints=[], streams={}, moves=moves)


def test_the_keys_of_the_json_object_are_those_of_the_page() -> None:
    options = CheckOptions(joints=("shoulder",))
    printed = report([judged(Rule.PAIRS, True, alone=0)]) | about(options, 5, record())
    assert list(printed) == first_cells("drivers.md", "key")
    text = (DOCS / "drivers.md").read_text(encoding="utf-8")
    for keys in (printed["driver"], printed["held_up"], {v.value: 0 for v in Verdict}):
        assert isinstance(keys, dict)
        assert [key for key in keys if f"`{key}`" not in text] == []


def test_every_check_is_in_the_table_of_the_page() -> None:
    rows = {row.partition(",")[0] for row in first_cells("drivers.md", "check")}
    for finding in judge(record()):
        check = finding.check
        if check.startswith("service "):
            check = "services"
        # Of a topic, or part of what is told of an end of torque.
        assert rows & {check, check.rpartition(": ")[2], check.partition(": ")[0]}, finding


@pytest.mark.parametrize("name", leaves(BridgeParameters))
def test_every_parameter_of_the_bridge_is_on_its_page(name: str) -> None:
    assert first_cells("drivers.md", "parameter").count(name) == 1
