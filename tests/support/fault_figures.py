"""What the tests of faults measured: one line for each hazard at the end of a test run."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest


@dataclass
class _Hazard:
    times: int = 0
    worst: dict[str, tuple[float, str]] = field(default_factory=dict)


class Figures:
    """Keeps, for each hazard, how often it was tried and the worst that came of it."""

    def __init__(self) -> None:
        self._hazards: dict[str, _Hazard] = {}

    def add(self, hazard: str, times: int = 1, **worst: tuple[float, str]) -> None:
        """Note what one try, or several, gave."""
        known = self._hazards.setdefault(hazard, _Hazard())
        known.times += times
        for name, (value, unit) in worst.items():
            largest = max(value, known.worst.get(name, (value, unit))[0])
            known.worst[name] = (largest, unit)

    def lines(self) -> list[str]:
        """Return one line for each hazard."""
        found = []
        for name, hazard in self._hazards.items():
            figures = (
                " ".join(filter(None, (quantity.replace("_", " "), _text(value), unit)))
                for quantity, (value, unit) in hazard.worst.items()
            )
            found.append(
                ": ".join(filter(None, (f"{name}, {hazard.times:,} ×", ", ".join(figures))))
            )
        return found


def _text(value: float) -> str:
    return f"{value:,.0f}" if value >= 1000.0 else f"{value:.3g}"


_FIGURES = pytest.StashKey[Figures]()


@pytest.fixture(scope="session")
def figures(pytestconfig: pytest.Config) -> Figures:
    """Takes what the tests measure."""
    return pytestconfig.stash.setdefault(_FIGURES, Figures())


def pytest_terminal_summary(
    terminalreporter: pytest.TerminalReporter, config: pytest.Config
) -> None:
    """Print what was measured."""
    if lines := config.stash.get(_FIGURES, Figures()).lines():
        terminalreporter.section("hazards: how often tried, and the worst that came of it")
        for line in lines:
            terminalreporter.write_line(line)
