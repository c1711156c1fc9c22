"""Where a process can be reached is told from what the kernel lists."""

import socket
import subprocess
import sys
from ipaddress import ip_address

import pytest

from armimp_common.sockets import Endpoint, endpoints, reachable_from_outside

LISTENER = """
import socket, sys
made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
made.bind(("127.0.0.1", 0))
print(made.getsockname()[1], flush=True)
sys.stdin.read()
"""


@pytest.mark.parametrize(
    ("kind", "protocol"), [(socket.SOCK_DGRAM, "udp"), (socket.SOCK_STREAM, "tcp")]
)
@pytest.mark.parametrize(("address", "outside"), [("127.0.0.1", False), ("0.0.0.0", True)])
def test_own_socket_is_found_as_long_as_it_is_open(
    kind: socket.SocketKind, protocol: str, address: str, outside: bool
) -> None:
    with socket.socket(socket.AF_INET, kind) as made:
        made.bind((address, 0))
        if kind is socket.SOCK_STREAM:
            assert not any(one.port == made.getsockname()[1] for one in endpoints())
            made.listen()
        expected = Endpoint(
            protocol=protocol, address=ip_address(address), port=made.getsockname()[1]
        )
        assert expected in endpoints()
        assert (expected in reachable_from_outside()) is outside
    assert expected not in endpoints()


@pytest.mark.skipif(not socket.has_ipv6, reason="this Python has no IPv6")
@pytest.mark.parametrize(("address", "outside"), [("::1", False), ("::", True)])
def test_own_socket_of_ipv6_is_found(address: str, outside: bool) -> None:
    with socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as made:
        try:
            made.bind((address, 0))
        except OSError:
            pytest.skip("this machine has no IPv6")
        expected = Endpoint(
            protocol="udp6", address=ip_address(address), port=made.getsockname()[1]
        )
        assert expected in endpoints()
        assert (expected in reachable_from_outside()) is outside


def test_sockets_of_another_process_are_its_own() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", LISTENER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout is not None
        port = int(other.stdout.readline())
        assert [one.port for one in endpoints(other.pid)] == [port]
        assert port not in [one.port for one in endpoints()]
        other.communicate()


def test_when_there_is_no_such_process_expect_an_error() -> None:
    with pytest.raises(OSError, match="999999999"):
        endpoints(999999999)
