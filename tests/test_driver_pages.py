"""docs/drivers.md says what the driver template, the driver check and the bridge do."""

from armimp_bringup.config import CheckOptions
from armimp_bringup.driver_check import Ending, Moves, Record
from armimp_bringup.driver_check.command import report
from armimp_bringup.driver_check.rules import judge
from armimp_common.schema import leaves
from armimp_driver_template.parameters import DriverParameters
from armimp_ros2_control.parameters import BridgeParameters
from support.pages import markdown_tables
from support.places import ROOT

PAGE = (ROOT / "docs" / "drivers.md").read_text(encoding="utf-8")


def first_cells(header: str) -> list[str]:
    """First column of all tables whose header begins with this cell, without backticks."""
    rows = [row for tables in markdown_tables(PAGE).values() for table in tables for row in table]
    return [row[header].replace("`", "") for row in rows if next(iter(row)) == header]


def record() -> Record:
    moves = Moves(stale=Ending(), stop=Ending())
    return Record(joints=("shoulder",), endpoints=[], streams={}, moves=moves)


def test_the_keys_of_the_json_object_are_those_of_the_page() -> None:
    printed = report(judge(record()), record(), CheckOptions(joints=("shoulder",)), 5)
    assert list(printed) == first_cells("key")
    assert [key for key in printed["findings"][0] if f"`{key}`" not in PAGE] == []


def test_every_check_is_in_the_table_of_the_page() -> None:
    rows = {row.partition(",")[0] for row in first_cells("check")}
    for finding in judge(record()):
        check = finding.check
        if check.startswith("service "):
            check = "services"
        # A check of a topic, or one of several where torque has to end.
        assert rows & {check, check.rpartition(": ")[2], check.partition(": ")[0]}, finding


def test_the_page_names_every_parameter_of_calibration_mock_and_bridge() -> None:
    groups = ("device_names", "encoder", "transducer", "drive", "mock")
    of_driver = [name for name in leaves(DriverParameters) if name.split(".")[0] in groups]
    assert sorted(first_cells("parameter")) == sorted([*of_driver, *leaves(BridgeParameters)])
