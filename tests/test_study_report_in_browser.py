"""The report of a study in a real browser: drawn, switched and sorted without the network."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from armimp_bringup.cli import main
from support.browser import Browser

pytestmark = pytest.mark.slow

CONDITIONS = "friction=0+3,resolution=0+3,perturbation=1+3"


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("study") / "out"
    options = ["--duration", "10", "--no-figures", "--only", CONDITIONS, "--seeds", "0:2"]
    main(["reproduce", "--out", str(directory), *options])
    return directory


@pytest.fixture
def page(browser: Browser, study: Path) -> Browser:
    browser.open(study / "report.html")
    return browser


def _name(friction: int, resolution: int, perturbation: int) -> str:
    levels = f"friction {friction}, resolution {resolution}, perturbation {perturbation}"
    return f"welch_siso, {levels}"


def _visible(browser: Browser) -> Any:
    return browser.value(
        "document.querySelector('#overlay-1-2 .canvas').data"
        ".filter((trace) => trace.visible).map((trace) => trace.name)"
    )


def test_study_report_is_drawn_without_complaint_and_without_the_network(
    page: Browser, study: Path
) -> None:
    assert page.said() == []
    assert page.requested() == [(study / "report.html").absolute().as_uri()]
    figures = page.value("[...document.querySelectorAll('figure.plot')].map((f) => f.id)")
    assert figures == [
        "overlay-1-1", "overlay-1-2", "overlay-2-1", "overlay-2-2",
        "levels-scores", "levels-coherence",
    ]  # fmt: skip
    for figure in figures:
        drawn = f"document.querySelectorAll('#{figure} .trace path').length"
        assert page.value(drawn) > 0, figure


def test_curves_are_chosen_by_estimator_perturbation_and_levels(page: Browser) -> None:
    levels = [(0, 0, 1), (0, 3, 1), (3, 0, 1), (3, 3, 1)]
    shown = [_name(*one) for one in levels]
    per_panel = [name for name in shown for _ in range(3)]
    assert _visible(page) == [*per_panel, "truth", "truth"]
    page.value("document.querySelector(\"input[data-switch='perturbation:3']\").click()")
    page.value("document.querySelector(\"input[data-switch='friction:0']\").click()")
    page.wait_for("document.querySelector('#overlay-1-2 .canvas').data[0].visible === false")
    page.wait_for(
        "document.querySelector('#overlay-1-2 .canvas').data"
        ".filter((trace) => trace.visible).length === 8"
    )
    per_panel = [name for name in (_name(3, 0, 3), _name(3, 3, 3)) for _ in range(3)]
    assert _visible(page) == [*per_panel, "truth", "truth"]
    assert page.said() == []
