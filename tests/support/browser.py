"""A headless Chromium that looks at reports."""

import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from playwright.sync_api import Page, sync_playwright

EXECUTABLE = shutil.which("chromium")


@contextmanager
def started() -> Iterator["Browser"]:
    """A running browser, if there is one on this machine (see `EXECUTABLE`)."""
    with sync_playwright() as playwright:
        flags = ["--no-sandbox", "--disable-gpu"]
        chromium = playwright.chromium.launch(executable_path=EXECUTABLE, args=flags)
        yield Browser(chromium.new_page())
        chromium.close()


class Browser:
    """A page, with its console output and its network requests."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self._said: list[str] = []
        self._requested: list[str] = []
        page.on("console", lambda message: self._said.append(message.text))
        page.on("pageerror", lambda error: self._said.append(str(error)))
        page.on("request", lambda request: self._requested.append(request.url))

    def open(self, file: Path, *, width: int = 1280) -> None:
        """Open a report and wait until its plots are drawn."""
        self.page.goto("about:blank")
        self._said.clear()
        self._requested.clear()
        self.page.set_viewport_size({"width": width, "height": 900})
        self.page.goto(file.absolute().as_uri())
        self.wait_for("document.documentElement.dataset.plots === 'drawn'")

    def value(self, expression: str) -> Any:
        """Value of a JavaScript expression in the page."""
        return self.page.evaluate(expression)

    def wait_for(self, condition: str) -> None:
        """Wait until a JavaScript expression is true."""
        # The page's own policy forbids what Playwright's `wait_for_function` does.
        deadline = time.monotonic() + 60.0
        while not self.value(condition):
            assert time.monotonic() < deadline, f"never true: {condition}"
            self.page.wait_for_timeout(20)

    def said(self) -> list[str]:
        """Everything on the console, errors of scripts and of the page's own policy included."""
        self.page.wait_for_timeout(50)
        return self._said

    def requested(self) -> list[str]:
        """Addresses that were asked for, but for data within the page."""
        return [one for one in self._requested if not one.startswith(("data:", "blob:"))]
