"""Interface between driver and device; only a device knows the bus."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True)
class Frame:
    """One sample of all joints, as it comes from the bus."""

    counter: int
    """Number of the sample since `Device.open`, from 0; lost frames are counted as well."""
    encoder: tuple[int, ...]
    """Raw counts of the encoders, 16 bits, which wrap."""
    transducer: tuple[int, ...]
    """Raw counts of the torque transducers."""


class Device(Protocol):
    """The exoskeleton behind its bus; made for a CAN bus with a SYNC frame each millisecond.

    Attributes
    ----------
    names : of its joints, in the order of frames and commands
    paced : whether samples come by themselves; only a mock can wait for commands
    """

    names: tuple[str, ...]
    paced: bool

    def open(self) -> None:
        """Connect; no drive has torque after that."""

    def close(self) -> None:
        """Free the drives and disconnect."""

    def receive(self, timeout: float) -> Frame | None:
        """Wait for the next frame, None if it does not come in time (s) or is damaged."""

    def send(self, torque: Sequence[float]) -> None:
        """Command torques of the drives (n,), N·m, which they hold until the next ones."""
