"""Bags of trials with gaps, or that were aborted: refused, or used as far as they go on request."""

from pathlib import Path

import pytest

from armimp_common.cdr import decode_trial_status, encode_trial_status
from armimp_common.status import Phase
from armimp_common.topics import PERIOD_NS, TORQUE_SENSORS, TRIAL
from armimp_estimation.problems import ProblemCode
from armimp_estimation.summary import FRF_FILE, SUMMARY_FILE, read_summary
from support.bag_files import write_bag
from support.command import call
from support.streams import changed
from support.synthetic_bags import recorded_arm

pytestmark = pytest.mark.usefixtures("environment")

LOST = range(2500, 2537)
BEFORE = 7000
"""Samples of the second trial before it is aborted."""
REASON = "arm_sim is dead"
MISSING = "samples of torque_sensors are missing: 37, between 2.500 s and 2.537 s"
Bags = dict[str, str]


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> Bags:
    """Recordings of two trials, of which the second has a gap, or is aborted."""
    arm, directory = recorded_arm(), tmp_path_factory.mktemp("bags")
    start_ns = arm.records[1].start_ns
    lost = {start_ns + tick * PERIOD_NS for tick in LOST}
    end_ns = start_ns + BEFORE * PERIOD_NS
    told = [raw for topic, time_ns, raw in arm.messages if topic == TRIAL and time_ns < end_ns][-1]
    aborted = changed(decode_trial_status(told), phase=Phase.ABORTED, valid=False, reason=REASON)
    messages = {
        "gaps": [m for m in arm.messages if m[0] != TORQUE_SENSORS or m[1] not in lost],
        "aborted": [
            *(m for m in arm.messages if m[1] < end_ns),
            (TRIAL, end_ns, encode_trial_status(aborted)),
        ],
    }
    return {kind: str(write_bag(directory / kind, m, {})) for kind, m in messages.items()}


@pytest.mark.parametrize("command", ["estimate", "replay"])
@pytest.mark.parametrize(("kind", "reason"), [("gaps", MISSING), ("aborted", f"aborted: {REASON}")])
def test_without_the_option_the_reason_is_one_line(
    bags: Bags, kind: str, reason: str, command: str
) -> None:
    told = call(command, bags[kind])
    assert told.status == 1
    lines = [line for line in told.err.splitlines() if line.startswith("armimp: ")]
    assert lines == [f"armimp: {bags[kind]}: trial 2: {reason}; --allow-gaps uses the intact parts"]


@pytest.mark.slow
def test_with_the_option_an_aborted_trial_is_estimated_up_to_there_but_not_valid(
    bags: Bags, tmp_path: Path
) -> None:
    results = [tmp_path / command for command in ("estimate", "replay")]
    for out in results:
        told = call(out.name, bags["aborted"], "--allow-gaps", "--out", str(out))
        assert told.status == 1
        assert told.err.count(f"not valid: trial 2: aborted: {REASON}") == 1
    offline, replayed = ((out / FRF_FILE).read_bytes() for out in results)
    assert offline == replayed
    one, other = (read_summary(out / SUMMARY_FILE) for out in results)
    assert one.estimators == other.estimators
    assert one.problems[0].code is ProblemCode.TRIAL_ABORTED
    assert (one.problems[0].trial, one.problems[0].values) == (2, {"reason": REASON})
    assert BEFORE - 2 <= one.trials[1].ticks <= BEFORE
