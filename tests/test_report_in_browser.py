"""The report in a real browser: drawn without a word of complaint, and without the network."""

from __future__ import annotations

import base64
import contextlib
import fcntl
import json
import os
import select
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from armimp_bringup.cli import main
from armimp_estimation.bags.synthetic import synthetic_recording
from armimp_estimation.report import load_result, write_report
from armimp_estimation.report.testing import METADATA, make_result

_FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-breakpad",
    "--remote-debugging-pipe",
)
# The browser takes its orders on descriptor 3 and answers on 4.
_START = (
    "import os, sys; os.dup2(int(sys.argv[1]), 3); os.dup2(int(sys.argv[2]), 4); "
    "os.execv(sys.argv[3], sys.argv[3:])"
)
_PATIENCE = 60.0
HOSTILE = "\"'><script>window.hacked = 1</script><img src=x onerror='window.hacked = 1'>"


def _pipe() -> tuple[int, int]:
    """Both ends of a pipe, on descriptors that are out of the way of 3 and 4."""
    low = os.pipe()
    receiving, sending = (fcntl.fcntl(end, fcntl.F_DUPFD_CLOEXEC, 10) for end in low)
    for end in low:
        os.close(end)
    return receiving, sending


class Browser:
    """A headless Chromium, driven by the DevTools protocol through pipes."""

    def __init__(self, executable: str, profile: Path) -> None:
        orders_in, orders_out = _pipe()
        answers_in, answers_out = _pipe()
        self._out, self._in = orders_out, answers_in
        start = [sys.executable, "-c", _START, str(orders_in), str(answers_out)]
        self._process = subprocess.Popen(
            [*start, executable, *_FLAGS, f"--user-data-dir={profile}", "about:blank"],
            pass_fds=(orders_in, answers_out),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(orders_in)
        os.close(answers_out)
        self._buffer = b""
        self._number = 0
        self._session: str | None = None
        self.events: list[dict[str, Any]] = []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)[
            "sessionId"
        ]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._number += 1
        order = {"id": self._number, "method": method, "params": parameters}
        if self._session is not None:
            order["sessionId"] = self._session
        os.write(self._out, json.dumps(order).encode() + b"\0")
        while True:
            answer = self._read()
            if answer.get("id") == self._number:
                assert "error" not in answer, answer
                result: dict[str, Any] = answer["result"]
                return result
            self.events.append(answer)

    def _read(self) -> dict[str, Any]:
        while b"\0" not in self._buffer:
            assert select.select([self._in], [], [], _PATIENCE)[0], "the browser does not answer"
            part = os.read(self._in, 1 << 20)
            assert part, "the browser has ended"
            self._buffer += part
        message, _, self._buffer = self._buffer.partition(b"\0")
        read: dict[str, Any] = json.loads(message)
        return read

    def value(self, expression: str) -> Any:
        """Value of a JavaScript expression in the page."""
        answer = self.call(
            "Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True
        )
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def open(self, page: Path, *, width: int = 1280) -> None:
        """Open a page and wait until its plots are drawn."""
        self.call("Page.navigate", url="about:blank")
        self.events.clear()
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=900,
            deviceScaleFactor=1,
            mobile=False,
        )
        self.call("Page.navigate", url=page.absolute().as_uri())
        self.wait_for("document.documentElement?.dataset.plots === 'drawn'")

    def wait_for(self, condition: str) -> None:
        deadline = time.monotonic() + _PATIENCE
        while not self.value(condition):
            assert time.monotonic() < deadline, f"never true: {condition}"
            time.sleep(0.02)

    def said(self) -> list[str]:
        """Everything on the console, errors of scripts and of the page's own policy included."""
        self.value("new Promise((resume) => setTimeout(resume, 50))")
        kinds = {"Runtime.consoleAPICalled", "Runtime.exceptionThrown", "Log.entryAdded"}
        return [json.dumps(event) for event in self.events if event["method"] in kinds]

    def requested(self) -> list[str]:
        """Addresses that were asked for, but for data within the page."""
        found = [
            str(event["params"]["request"]["url"])
            for event in self.events
            if event["method"] == "Network.requestWillBeSent"
        ]
        return [address for address in found if not address.startswith(("data:", "blob:"))]

    def close(self) -> None:
        self._session = None
        with contextlib.suppress(AssertionError, OSError):
            self.call("Browser.close")
        try:
            self._process.wait(10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        os.close(self._out)
        os.close(self._in)


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    executable = shutil.which("chromium")
    if executable is None:
        pytest.skip("there is no chromium to look at the report with (apt-get install chromium)")
    started = Browser(executable, tmp_path_factory.mktemp("profile"))
    yield started
    started.close()


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


def test_verdict_is_read_first(page: Browser) -> None:
    assert page.value("document.querySelector('main h2').textContent") == "Valid"
    assert "arm impedance, valid" in page.value("document.title")


def test_switches_hide_and_show_lines_in_all_plots(page: Browser) -> None:
    single, full = "Welch, single input", "Welch, full matrix"
    assert shown(page, "bode-1-2") == {single: 2, full: 2, "truth": 2, "": 4}
    drawn = paths(page, "bode-1-2")

    switch(page, "estimator:welch_full")
    page.wait_for("document.querySelector('#coherence-2-2 .canvas').data[3].visible === false")
    assert shown(page, "bode-1-2") == {single: 2, "truth": 2, "": 2}
    assert f"derived, {full}" not in shown(page, "coherence-2-2")
    assert paths(page, "bode-1-2") < drawn
    # The control beside the other plots follows.
    twins = "[...document.querySelectorAll(\"input[data-switch='estimator:welch_full']\")]"
    assert page.value(f"{twins}.map((box) => box.checked)") == [False, False]

    switch(page, "bands")
    switch(page, "truth")
    page.wait_for("document.querySelector('#bode-2-2 .canvas').data.at(-1).visible === false")
    assert shown(page, "bode-2-2") == {single: 2}

    for tag in ("estimator:welch_full", "bands", "truth"):
        switch(page, tag)
    page.wait_for("document.querySelector('#bode-2-2 .canvas').data.at(-1).visible === true")
    page.wait_for("document.querySelector('#coherence-2-2 .canvas').data[3].visible === true")
    assert paths(page, "bode-1-2") == drawn
    assert page.said() == []


def test_the_ends_of_a_trial_are_shown_in_full(page: Browser) -> None:
    canvas = "document.querySelector('#trace-1 .canvas')"
    step = f"{canvas}.data[0].dx"
    assert page.value(step) == pytest.approx(0.005)
    page.value("document.querySelectorAll('#trace-1 input')[2].click()")
    page.wait_for(f"{step} < 0.002")
    assert page.value(step) == pytest.approx(0.001)
    assert page.value(f"{canvas}.layout.xaxis.range") == pytest.approx([8.0, 10.0])
    assert page.said() == []


def test_no_button_sends_data_anywhere(page: Browser) -> None:
    buttons = page.value(
        "[...document.querySelector('.modebar').querySelectorAll('.modebar-btn')]"
        ".map((button) => button.dataset.title)"
    )
    assert len(buttons) == 4
    assert not [title for title in buttons if "hare" in title or "loud" in title]


def test_the_page_itself_forbids_requests_and_foreign_scripts(page: Browser) -> None:
    refused = page.value("fetch('https://example.org/').then(() => 'sent', () => 'refused')")
    assert refused == "refused"
    page.value(
        "document.body.append(Object.assign(document.createElement('script'),"
        " {textContent: 'window.hacked = 1'}))"
    )
    assert page.value("typeof window.hacked") == "undefined"
    assert any("Content Security Policy" in line for line in page.said())


@pytest.mark.parametrize("width", [360, 800, 1600])
def test_the_page_fits_any_screen(browser: Browser, valid: Path, width: int) -> None:
    browser.open(valid, width=width)
    assert browser.value("document.documentElement.scrollWidth") <= width
    canvas = "document.querySelector('#bode-1-1 .main-svg').getBoundingClientRect().width"
    assert 250 < browser.value(canvas) <= width


def test_print_shows_everything_and_leaves_the_screen_as_it_was(page: Browser) -> None:
    width = "document.querySelector('#trace-1 .main-svg').getAttribute('width')"
    before = page.value(width)
    page.value(
        "addEventListener('beforeprint', () => {"
        " window.folded = document.querySelectorAll('details:not([open])').length;"
        " window.printed = " + width + "; })"
    )
    printed = base64.b64decode(page.call("Page.printToPDF")["data"])
    assert printed.startswith(b"%PDF")
    assert page.value("window.folded") == 0
    assert int(page.value("window.printed")) < int(before)
    page.wait_for(f"{width} === '{before}'")
    assert page.value("document.querySelectorAll('details[open]').length") == 0
    assert page.said() == []


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


def test_the_command_writes_a_report_of_an_invalid_result_too(
    browser: Browser, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    recording = synthetic_recording(ticks=5000)  # of the first joint only
    make_result(tmp_path / "one", messages=recording.messages, metadata={})
    bag = str(tmp_path / "one" / "bags" / "session")
    assert main(["estimate", bag, "--out", str(tmp_path / "out")]) == 1
    capfd.readouterr()
    browser.open(tmp_path / "out" / "report.html")

    assert browser.said() == []
    verdict = browser.value("document.querySelector('#verdict').textContent")
    assert verdict.startswith("Not valid: 1 problem")
    assert "no trial perturbs joint 2 (elbow)" in verdict
    assert "Record what is missing" in verdict
    assert paths(browser, "trace-1") >= 5
