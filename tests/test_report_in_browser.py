"""Reports in a real browser: drawn without a word of complaint, and without the network."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import pytest

from armimp_estimation.report.run import write_report
from armimp_estimation.result import load_result
from support.browser import EXECUTABLE, Browser, started
from support.command import call
from support.results import METADATA, make_result
from support.synthetic_bags import synthetic_recording

HOSTILE = "\"'><script>window.hacked = 1</script><img src=x onerror='window.hacked = 1'>"


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    if EXECUTABLE is None:
        pytest.skip("there is no chromium to look at the report with (apt-get install chromium)")
    with started() as browser:
        yield browser


@pytest.fixture(scope="module")
def valid(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = make_result(tmp_path_factory.mktemp("valid") / "result")
    return write_report(directory, load_result(directory))


@pytest.fixture
def page(browser: Browser, valid: Path) -> Browser:
    browser.open(valid)
    return browser


def shown(browser: Browser, figure: str) -> dict[str, int]:
    """Lines which are visible in a plot, by name, and the number of bands ("")."""
    counted: dict[str, int] = browser.value(
        f"""(() => {{
            const counts = {{}};
            for (const trace of document.querySelector("#{figure} .canvas").data) {{
                const name = trace.name || "";
                if (trace.visible) counts[name] = (counts[name] || 0) + 1;
            }}
            return counts;
        }})()"""
    )
    return counted


def paths(browser: Browser, figure: str) -> int:
    """Lines and bands that are really drawn in a plot."""
    query = f"#{figure} .scatterlayer .trace path[d^='M']"
    return int(browser.value(f'document.querySelectorAll("{query}").length'))


def switch(browser: Browser, tag: str) -> None:
    browser.value(f"document.querySelector(\"input[data-switch='{tag}']\").click()")


def test_report_is_drawn_without_complaint_and_without_the_network(
    page: Browser, valid: Path
) -> None:
    assert page.said() == []
    assert page.requested() == [valid.absolute().as_uri()]
    figures = page.value("[...document.querySelectorAll('figure.plot')].map((f) => f.id)")
    assert len(figures) == 10
    for figure in figures:
        assert paths(page, figure) >= 4, figure


def test_switches_hide_and_show_lines_in_all_plots(page: Browser) -> None:
    single, full = "welch_siso", "welch_full"
    # Magnitude, phase and distance of each estimator, with a band around each or about zero.
    assert shown(page, "bode-1-2") == {single: 3, full: 3, "truth": 2, "": 6}
    drawn = paths(page, "bode-1-2")

    switch(page, "estimator:welch_full")
    page.wait_for("document.querySelector('#coherence-2-2 .canvas').data[3].visible === false")
    assert shown(page, "bode-1-2") == {single: 3, "truth": 2, "": 3}
    assert f"derived, {full}" not in shown(page, "coherence-2-2")
    assert paths(page, "bode-1-2") < drawn
    # The control beside the other plots follows.
    twins = "[...document.querySelectorAll(\"input[data-switch='estimator:welch_full']\")]"
    assert page.value(f"{twins}.map((box) => box.checked)") == [False, False]

    switch(page, "bands")
    switch(page, "truth")
    page.wait_for("document.querySelector('#bode-2-2 .canvas').data.at(-1).visible === false")
    assert shown(page, "bode-2-2") == {single: 3}

    for tag in ("estimator:welch_full", "bands", "truth"):
        switch(page, tag)
    page.wait_for("document.querySelector('#bode-2-2 .canvas').data.at(-1).visible === true")
    page.wait_for("document.querySelector('#coherence-2-2 .canvas').data[3].visible === true")
    assert paths(page, "bode-1-2") == drawn
    assert page.said() == []


def test_the_end_of_a_trial_is_shown_in_full(page: Browser) -> None:
    canvas = "document.querySelector('#trace-1 .canvas')"
    step = f"{canvas}._fullData[0].x[1] - {canvas}._fullData[0].x[0]"
    assert page.value(step) == pytest.approx(0.005, rel=1e-3)
    page.value("document.querySelectorAll('#trace-1 input')[1].click()")
    page.wait_for(f"{step} < 0.002")
    assert page.value(step) == pytest.approx(0.001, rel=1e-3)
    assert page.value(f"{canvas}.layout.xaxis.range") == pytest.approx([8.0, 10.0])
    assert page.said() == []


def test_page_and_plots_follow_the_colour_scheme_of_the_system_but_on_paper(page: Browser) -> None:
    ink = "document.querySelector('#trace-2 .canvas')._fullLayout.font.color"  # drawn last
    schemes: tuple[tuple[Literal["dark", "light"], str, str], ...] = (
        ("dark", "#e3e7eb", "rgb(21, 25, 29)"),
        ("light", "#1d2329", "rgb(255, 255, 255)"),
    )
    for scheme, colour, paper in schemes:
        page.page.emulate_media(color_scheme=scheme)
        page.wait_for(f"{ink} === '{colour}'")
        assert page.value("getComputedStyle(document.body).backgroundColor") == paper
        page.value("dispatchEvent(new Event('beforeprint'))")
        assert page.value(ink) == "#1d2329"
        page.value("dispatchEvent(new Event('afterprint'))")
        assert page.value(ink) == colour
    assert page.said() == []


@pytest.mark.parametrize(
    "width", [360, *(pytest.param(wider, marks=pytest.mark.slow) for wider in (800, 1600))]
)
def test_the_page_fits_any_screen(browser: Browser, valid: Path, width: int) -> None:
    browser.open(valid, width=width)
    assert browser.value("document.documentElement.scrollWidth") <= width
    canvas = "document.querySelector('#bode-1-1 .main-svg').getBoundingClientRect().width"
    assert 250 < browser.value(canvas) <= width


@pytest.mark.slow
def test_print_shows_everything_and_leaves_the_screen_as_it_was(page: Browser) -> None:
    width = "document.querySelector('#trace-1 .main-svg').getAttribute('width')"
    before = page.value(width)
    page.value(
        "addEventListener('beforeprint', () => {"
        " window.folded = document.querySelectorAll('details:not([open])').length;"
        " window.printed = " + width + "; })"
    )
    assert page.page.pdf().startswith(b"%PDF")
    assert page.value("window.folded") == 0
    assert int(page.value("window.printed")) < int(before)
    page.wait_for(f"{width} === '{before}'")
    assert page.value("document.querySelectorAll('details[open]').length") == 0
    assert page.said() == []


@pytest.mark.slow
def test_hostile_names_do_nothing(browser: Browser, tmp_path: Path) -> None:
    names = [HOSTILE, "<a href='javascript:window.hacked = 1'>name</a>"]
    recording = synthetic_recording(joint_names=names, perturbed=(0, 1), ticks=5000)
    config = json.dumps({HOSTILE: {HOSTILE: [HOSTILE]}, "experiment": HOSTILE})
    metadata = {**METADATA, "config": config, "truth": "null"}
    directory = make_result(tmp_path / "out", messages=recording.messages, metadata=metadata)
    browser.open(write_report(directory, load_result(directory)))

    assert browser.said() == []
    assert browser.value("typeof window.hacked") == "undefined"
    assert browser.value("document.querySelectorAll('main img, main a').length") == 0
    assert HOSTILE in browser.value("document.querySelector('h1').textContent")


CONDITIONS = "friction=0+3,resolution=0+3,perturbation=1+3"


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("study") / "out"
    options = ["--duration", "10", "--no-figures", "--only", CONDITIONS, "--seeds", "0:2"]
    call("reproduce", "--out", str(directory), *options)
    return directory


VISIBLE = "document.querySelector('#overlay-1-2 .canvas').data.filter((trace) => trace.visible)"


@pytest.fixture
def study_page(browser: Browser, study: Path) -> Browser:
    browser.open(study / "report.html")
    return browser


def _visible(browser: Browser) -> Any:
    return browser.value(f"{VISIBLE}.map((trace) => trace.name)")


def _curves(*levels: tuple[int, int, int]) -> list[str]:
    """Names of the curves of these levels, three in each panel, and of the truth."""
    names = (f"welch_siso, friction {f}, resolution {r}, perturbation {p}" for f, r, p in levels)
    return [*(name for name in names for _ in range(3)), "truth", "truth"]


@pytest.mark.slow
def test_study_report_is_drawn_without_complaint_and_without_the_network(
    study_page: Browser, study: Path
) -> None:
    assert study_page.said() == []
    assert study_page.requested() == [(study / "report.html").absolute().as_uri()]
    figures = study_page.value("[...document.querySelectorAll('figure.plot')].map((f) => f.id)")
    assert figures == [
        "overlay-1-1", "overlay-1-2", "overlay-2-1", "overlay-2-2",
        "levels-scores", "levels-coherence",
    ]  # fmt: skip
    for figure in figures:
        drawn = f"document.querySelectorAll('#{figure} .trace path').length"
        assert study_page.value(drawn) > 0, figure


@pytest.mark.slow
def test_curves_are_chosen_by_estimator_perturbation_and_levels(study_page: Browser) -> None:
    assert _visible(study_page) == _curves((0, 0, 1), (0, 3, 1), (3, 0, 1), (3, 3, 1))
    study_page.value("document.querySelector(\"input[data-switch='perturbation:3']\").click()")
    study_page.value("document.querySelector(\"input[data-switch='friction:0']\").click()")
    study_page.wait_for(f"{VISIBLE}.length === 8")
    assert _visible(study_page) == _curves((3, 0, 3), (3, 3, 3))
    assert study_page.said() == []
