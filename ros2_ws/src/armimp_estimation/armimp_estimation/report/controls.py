"""Controls that switch lines in all plots of a page, and keys that say what lines mean."""

from __future__ import annotations

from collections.abc import Sequence

from armimp_estimation.report.html import Html, element


def switch(tag: str, label: object, colour: str, style: str, *, wide: bool = False) -> Html:
    """Make a box that shows or hides what carries a tag; drawn like the lines it stands for.

    Parameters
    ----------
    tag : str
        Of the lines, see `armimp_estimation.report.plots.Stroke`.
    label : object
        For people.
    colour, style : str
        As CSS has them.
    wide : bool
        Whether it stands for bands.
    """
    box = element("input", type="checkbox", checked=True, autocomplete="off", data_switch=tag)
    return element("label", box, _swatch(colour, style, wide=wide), label)


def choice(name: str, legend: object, options: Sequence[tuple[str, object]]) -> Html:
    """Make buttons of which exactly one is pressed: what carries another's tag is hidden.

    Parameters
    ----------
    name : str
        Unique in the page.
    legend : object
        What there is to choose.
    options : sequence of (str, object)
        Tag and label of each; the first one is chosen to begin with.
    """
    buttons = (
        element(
            "label",
            element(
                "input",
                type="radio",
                name=name,
                checked=number == 0,
                autocomplete="off",
                data_switch=tag,
            ),
            label,
        )
        for number, (tag, label) in enumerate(options)
    )
    return element("fieldset", element("legend", legend), *buttons, class_="switches")


def key(colour: str, style: str, label: object) -> Html:
    """Say what a line of this colour and style means."""
    return element("span", _swatch(colour, style), label)


def _swatch(colour: str, style: str, *, wide: bool = False) -> Html:
    width = 9 if wide else 3
    return element("i", style=f"border-top:{width}px {style} {colour}")
