"""Domains are claimed so that experiments do not meet, and no user keeps others out."""

import os
import socket

import pytest

from armimp_bringup import graph as domain
from armimp_bringup.graph import DomainClaim
from armimp_common.errors import GraphError


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
