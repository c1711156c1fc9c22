"""HTML pages taken apart as a browser sees them, and tables of Markdown pages."""

import re
from html.parser import HTMLParser


class Page(HTMLParser):
    """Elements of a page, its text outside of scripts, and its scripts."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.scripts: list[tuple[dict[str, str | None], str]] = []
        self.words = ""
        self._open: str = ""
        self.feed(page)
        self.close()
        self.words = " ".join(self.words.split())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        self._open = tag
        if tag == "script":
            self.scripts.append((dict(attrs), ""))

    def handle_endtag(self, tag: str) -> None:
        self._open = ""

    def handle_data(self, data: str) -> None:
        if self._open == "script":
            attributes, text = self.scripts[-1]
            self.scripts[-1] = (attributes, text + data)
        elif self._open != "style":
            self.words += data + " "


def markdown_tables(page: str) -> dict[str, list[list[dict[str, str]]]]:
    """Return the tables under each heading, without its number and backticks; rows by column."""
    found: dict[str, list[list[dict[str, str]]]] = {}
    heading, header = "", None
    for line in page.splitlines():
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if line.startswith("#"):
            heading = re.sub(r"^#+ (\d+\. )?", "", line).replace("`", "")
        if not line.startswith("|"):
            header = None
        elif header is None:
            header = cells
            found.setdefault(heading, []).append([])
        elif not set(line) <= set("|-: "):
            assert len(cells) == len(header), f"wrong number of cells: {line}"
            found[heading][-1].append(dict(zip(header, cells, strict=True)))
    return found
