"""What the tests of faults measured: one line for each hazard at the end of a test run."""

from collections import Counter, defaultdict

import pytest


class Figures:
    """Keeps, for each hazard, the number of attempts and the worst of each figure."""

    def __init__(self) -> None:
        self._times: Counter[str] = Counter()
        self._worst: dict[str, dict[str, tuple[float, str]]] = defaultdict(dict)

    def add(self, hazard: str, times: int = 1, **worst: tuple[float, str]) -> None:
        """Record the figures (value, unit) of one attempt, or of several."""
        self._times[hazard] += times
        known = self._worst[hazard]
        for name, figure in worst.items():
            known[name] = max(figure, known.get(name, figure))

    def lines(self) -> list[str]:
        """Return one line for each hazard."""
        found = []
        for hazard, times in self._times.items():
            figures = ", ".join(
                f"{name.replace('_', ' ')} {_text(value)} {unit}".rstrip()
                for name, (value, unit) in self._worst[hazard].items()
            )
            found.append(f"{hazard}, {times:,} ×: {figures}".removesuffix(": "))
        return found


def _text(value: float) -> str:
    return f"{value:,.0f}" if value >= 1000.0 else f"{value:.3g}"


_FIGURES = pytest.StashKey[Figures]()


@pytest.fixture(scope="session")
def figures(pytestconfig: pytest.Config) -> Figures:
    """Collector of what the tests measure."""
    return pytestconfig.stash.setdefault(_FIGURES, Figures())


def pytest_terminal_summary(
    terminalreporter: pytest.TerminalReporter, config: pytest.Config
) -> None:
    """Print what was measured."""
    if lines := config.stash.get(_FIGURES, Figures()).lines():
        terminalreporter.section("hazards: how often tried, and the worst that came of it")
        for line in lines:
            terminalreporter.write_line(line)
