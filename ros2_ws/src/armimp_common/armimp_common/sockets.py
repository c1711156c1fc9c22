"""The addresses at which a process can be reached over the network, as Linux lists them."""

from __future__ import annotations

import socket
import struct
from contextlib import suppress
from dataclasses import dataclass
from ipaddress import IPv4Address, IPv6Address, ip_address
from pathlib import Path

_LISTENING = "0A"
"""State of a TCP socket that waits for connections; see proc(5)."""


@dataclass(frozen=True, kw_only=True, order=True)
class Endpoint:
    """Where a socket can be reached.

    Parameters
    ----------
    protocol
        ``udp``, ``tcp``, ``udp6`` or ``tcp6``.
    address
        Of the interface; all zeros means each there is.
    port
        Its number.
    """

    protocol: str
    address: IPv4Address | IPv6Address
    port: int


def endpoints(process: int | None = None) -> set[Endpoint]:
    """Return the endpoints of a process; of this one by default.

    Parameters
    ----------
    process
        Number of a process whose files this user may see.

    Raises
    ------
    OSError
        If there is no such process, or no ``/proc``.
    """
    place = Path("/proc") / ("self" if process is None else str(process))
    own = set()
    for file in (place / "fd").iterdir():
        with suppress(OSError):  # It was closed meanwhile.
            kind, _, number = str(file.readlink()).partition(":")
            if kind == "socket":
                own.add(number.strip("[]"))
    found = set()
    for protocol in ("udp", "udp6", "tcp", "tcp6"):
        table = place / "net" / protocol
        rows = table.read_text(encoding="ascii").splitlines()[1:] if table.exists() else []
        for row in rows:
            _, local, _, state, *_, inode = row.split()[:10]
            if inode in own and (protocol.startswith("udp") or state == _LISTENING):
                address, port = local.split(":")
                found.add(
                    Endpoint(protocol=protocol, address=_address(address), port=int(port, 16))
                )
    return found


def reachable_from_outside(process: int | None = None) -> set[Endpoint]:
    """Return the `endpoints` of a process that other machines can reach."""
    return {one for one in endpoints(process) if not one.address.is_loopback}


def _address(text: str) -> IPv4Address | IPv6Address:
    # Words of 32 bits, each in the order of bytes of this machine.
    words = [int(text[i : i + 8], 16) for i in range(0, len(text), 8)]
    family = socket.AF_INET if len(words) == 1 else socket.AF_INET6
    return ip_address(socket.inet_ntop(family, struct.pack(f"={len(words)}I", *words)))
