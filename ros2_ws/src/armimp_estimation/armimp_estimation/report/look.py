"""Names and colours of estimators, joints and levels, the same in every report and figure.

One colour stands for one thing. Estimators have those of Okabe and Ito, joints those that Tol calls
muted, levels steps from light to dark: all can be told apart by colour-blind people. Lines differ
in their dashes as well. A page has them as variables of its style, with a lighter set for the dark
mode; plots name them so, ``--estimator-0``, and ``plots.js`` looks them up.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

_PALETTES: Mapping[str, Sequence[tuple[str, str]]] = {
    "estimator": (
        *(("#0072b2", "#4aa8e0"), ("#d55e00", "#ff8a3d"), ("#009e73", "#2cc79b")),
        *(("#cc79a7", "#e79bc4"), ("#56b4e9", "#8fd0f5"), ("#e69f00", "#f5bd4a")),
    ),
    "joint": (
        *(("#332288", "#9a8cf0"), ("#cc6677", "#e58391"), ("#44aa99", "#5cc4b3")),
        *(("#999933", "#c2c25a"), ("#88ccee", "#88ccee"), ("#882255", "#d46a9f")),
        ("#5f5f5f", "#b5b5b5"),
    ),
    "level": (
        *(("#b8a500", "#fde725"), ("#35a06a", "#4fd18b"), ("#2f6f8f", "#58a8cf")),
        ("#440154", "#c06fd6"),
    ),
    "signal": (("#8a8a8a", "#9a9a9a"), ("#2b2b2b", "#dddddd")),
    "ink": (("#1d2329", "#e3e7eb"),),
    "soft": (("#55606b", "#a2adb8"),),
    "rule": (("#d5dae0", "#3a424b"),),
    "paper": (("#ffffff", "#15191d"),),
    "shade": (("#f5f7f9", "#1e242a"),),
    "good": (("#00704f", "#41c79b"),),
    "bad": (("#b03a00", "#ff8a5c"),),
    "link": (("#005a94", "#6db8f0"),),
}
"""Colours in the light and in the dark mode."""
COLOURS = tuple(light for light, _ in _PALETTES["estimator"])
ELEMENT_COLOURS = ("#4477aa", "#ee6677", "#228833", "#ccbb44", "#66ccee", "#aa3377", "#8f8f8f")
"""Of elements that are compared with each other: those that Tol calls bright."""
LEVEL_COLOURS = tuple(light for light, _ in _PALETTES["level"])
LEVEL_DASHES = ("solid", "dash", "dashdot", "dot")
"""Of friction and resolution in a study."""
TRUTH_COLOUR = "#000000"
MOTION_COLOUR, TORQUE_COLOUR = (light for light, _ in _PALETTES["signal"])
"""Of the coherences of the perturbation with angle and torque."""
DASHES = ("solid", "dash", "dashdot", "longdash", "longdashdot", "dot")
"""As plotly names them; dotted is the truth's own, so it comes last."""
_KNOWN = ("welch_siso", "welch_full", "lpm_full", "direct", "mimo")


@dataclass(frozen=True, kw_only=True)
class Look:
    """How an estimator appears, under the name that it has everywhere.

    Attributes
    ----------
    name : str
        Of the estimator.
    number : int
        Of its colour.
    """

    name: str
    number: int

    @property
    def colour(self) -> str:
        """Of its lines, ``#rrggbb``."""
        return COLOURS[self.number]

    @property
    def variable(self) -> str:
        """Colour of its lines in a page."""
        return f"--estimator-{self.number}"

    @property
    def dash(self) -> str:
        """Of its lines, as plotly names it."""
        return DASHES[self.number]


def looks(names: Iterable[str]) -> dict[str, Look]:
    """Looks of estimators by name. Known ones always look alike, others get what is left."""
    wanted = list(names)
    order = [*_KNOWN, *(name for name in wanted if name not in _KNOWN)]
    return {name: Look(name=name, number=order.index(name) % len(COLOURS)) for name in wanted}


def joint_colour(joint: int) -> str:
    """Colour of a joint (0-based)."""
    return _PALETTES["joint"][joint % 7][0]


def joint_variable(joint: int) -> str:
    """Colour of a joint (0-based) in a page."""
    return f"--joint-{joint % 7}"


def style_rules() -> str:
    """Rules of a style sheet that define the colours in both modes."""

    def rules(mode: int) -> str:
        return "".join(
            f"--{name}{f'-{number}' if len(colours) > 1 else ''}:{colours[number][mode]};"
            for name, colours in _PALETTES.items()
            for number in range(len(colours))
        )

    return (
        f":root{{{rules(0)}}}\n"
        f"@media screen and (prefers-color-scheme:dark){{:root{{{rules(1)}}}}}\n"
    )
