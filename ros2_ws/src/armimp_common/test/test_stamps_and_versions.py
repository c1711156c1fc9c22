"""Stamps, versions, revision, diagnostics and domain ids."""

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from hypothesis import given
from hypothesis import strategies as st

from armimp_common import diagnostics, domain, stamps
from armimp_common.diagnostics import Level
from armimp_common.domain import DomainClaim
from armimp_common.errors import ConfigurationError, GraphError
from armimp_common.trial_status import Phase, TrialStatus
from armimp_common.versions import git_revision, versions

TRIAL = TrialStatus(
    phase=Phase.SETTLE,
    trial=1,
    trials=2,
    joint=0,
    joint_name="shoulder",
    tick=0,
    start_ns=None,
    ticks=100,
    seed=1,
    valid=True,
)


@given(stamp=st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1))
def test_any_stamp_survives_the_time_message(stamp: int) -> None:
    assert stamps.to_ns(stamps.to_time(stamp)) == stamp


@given(tick=st.integers(-(10**9), 10**9), start=st.integers(0, 2**60), late=st.integers(0, 499_999))
def test_tick_survives_jitter_below_half_a_period(tick: int, start: int, late: int) -> None:
    stamp = stamps.tick_to_ns(tick, start)

    assert stamp == start + tick * 1_000_000
    assert stamps.ns_to_tick(stamp + late, start) == tick
    assert stamps.ns_to_tick(stamp - late, start) == tick


def test_nanoseconds_to_seconds() -> None:
    assert stamps.ns_to_seconds(1_500_000_000) == 1.5


def test_versions_name_everything_that_computes() -> None:
    found = versions()

    assert list(found) == [
        "python", "numpy", "scipy", "numba", "rclpy", "rosbags", "mcap", "armimp",
    ]  # fmt: skip
    assert found["python"] == ".".join(map(str, sys.version_info[:3]))
    assert found["rclpy"].startswith("7.1."), "rclpy of ROS 2 Jazzy"
    assert "unknown" not in (found["numpy"], found["python"])


def git(directory: Path, *arguments: str) -> str:
    identity = ["-c", "user.name=tester", "-c", "user.email=tester@example.org"]
    done = subprocess.run(
        ["git", "-C", str(directory), *identity, *arguments],
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.strip()


def test_git_revision_tells_commit_and_changes(tmp_path: Path) -> None:
    assert git_revision(tmp_path) == "unknown", "no repository"
    git(tmp_path, "init", "--quiet")
    assert git_revision(tmp_path) == "unknown", "no commit"

    (tmp_path / "file").write_text("one")
    git(tmp_path, "add", "file")
    git(tmp_path, "commit", "--quiet", "--no-verify", "--message", "one")
    commit = git(tmp_path, "rev-parse", "HEAD")
    assert git_revision(tmp_path) == commit

    (tmp_path / "result").write_text("untracked files are no change of the sources")
    assert git_revision(tmp_path) == commit
    (tmp_path / "file").write_text("two")
    assert git_revision(tmp_path) == f"{commit}+dirty"


def test_when_there_is_no_git_expect_unknown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))

    assert git_revision() == "unknown"


@pytest.mark.parametrize(
    ("value", "text"),
    [
        ("text", "text"),
        (True, "true"),
        (False, "false"),
        (3, "3"),
        (0.1, "0.1"),
        (1e-7, "1e-07"),
        ((0.1, 2), "0.1 2.0"),
        ([], ""),
    ],
)
def test_values_are_written_without_loss(value: diagnostics.Value, text: str) -> None:
    assert diagnostics.format_value(value) == text


def test_status_carries_level_words_and_values_in_order() -> None:
    status = diagnostics.make_status(
        "arm_sim: rates", Level.WARN, "late", {"rate": 999.5, "late": 3}, hardware_id="sim"
    )
    array = diagnostics.make_array(1_000_000_002, [status])

    assert status.level == DiagnosticStatus.WARN
    assert (status.name, status.message, status.hardware_id) == ("arm_sim: rates", "late", "sim")
    assert list(diagnostics.values_of(status).items()) == [("rate", "999.5"), ("late", "3")]
    assert array.status == [status]
    assert (array.header.stamp.sec, array.header.stamp.nanosec) == (1, 2)


def test_levels_are_those_of_the_message() -> None:
    for level in Level:
        assert bytes([level]) == getattr(DiagnosticStatus, level.name)
    assert diagnostics.worst([]) is Level.OK
    assert diagnostics.worst([Level.WARN, Level.ERROR, Level.OK]) is Level.ERROR


@pytest.mark.parametrize(
    ("phase", "valid", "level"),
    [
        (Phase.SETTLE, True, DiagnosticStatus.OK),
        (Phase.SETTLE, False, DiagnosticStatus.WARN),
        (Phase.ABORTED, False, DiagnosticStatus.ERROR),
    ],
)
def test_trial_status_survives_its_message(phase: Phase, valid: bool, level: bytes) -> None:
    trial = TrialStatus(**{**vars(TRIAL), "phase": phase, "valid": valid, "reason": "why"})

    message = diagnostics.trial_status_message(trial)

    assert message.level == level
    assert message.message == trial.sentence
    assert TrialStatus.from_values(diagnostics.values_of(message)) == trial


def test_when_two_claim_domains_expect_different_ones() -> None:
    with DomainClaim() as first, DomainClaim() as second:
        assert first.domain_id != second.domain_id
        assert {first.domain_id, second.domain_id} <= set(range(1, 101))


def test_when_a_domain_is_taken_expect_graph_error_until_released() -> None:
    with DomainClaim() as held:
        domain_id = held.domain_id
        with pytest.raises(GraphError, match=f"domain id {domain_id} is taken"):
            DomainClaim(domain_id)
    with DomainClaim(domain_id) as again:
        assert again.domain_id == domain_id


def test_when_a_program_of_another_kind_is_in_a_domain_expect_it_avoided() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other, DomainClaim() as first:
        free = first.domain_id
        other.bind(("0.0.0.0", 7400 + 250 * free + 10))
        first.release()
        assert free in set().union(*domain._occupied().values())


def test_when_one_user_holds_every_domain_expect_no_other_kept_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    me = os.getuid()
    everything = set(range(domain.LOWEST, domain.HIGHEST + 1))
    theirs, rest = everything - {7}, {7}
    monkeypatch.setattr(DomainClaim, "_bind", _taken)
    monkeypatch.setattr(domain, "_occupied", lambda: {me + 1: theirs, me + 2: rest})
    with DomainClaim() as claim:
        assert claim.domain_id in theirs

    # One's own experiments are kept apart however many there are.
    monkeypatch.setattr(domain, "_occupied", lambda: {me: everything})
    with pytest.raises(GraphError, match="no domain id is free"):
        DomainClaim()


def _taken(claim: DomainClaim, domain_id: int) -> bool:
    claim.domain_id = domain_id
    return False


@pytest.mark.parametrize("domain_id", [-1, 101])
def test_when_domain_is_out_of_range_expect_configuration_error(domain_id: int) -> None:
    with pytest.raises(ConfigurationError, match=str(domain_id)):
        DomainClaim(domain_id)
