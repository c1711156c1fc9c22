"""Names and colours of estimators, joints and levels, the same in every report and figure.

One colour stands for one thing. Estimators have those of Okabe and Ito, joints those that Tol calls
muted, elements those that he calls bright, levels steps from light to dark: all can be told apart
by colour-blind people. Lines differ in their dashes as well. A page has them as variables of its
style, with a lighter set for the dark mode; charts name them so, ``--estimator-0``. A page looks
them up in ``plots.js``, a figure with `printed`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from armimp_estimation.report.plots import Stroke

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
    "element": tuple(
        (colour, colour)
        for colour in ("#4477aa", "#ee6677", "#228833", "#ccbb44", "#66ccee", "#aa3377", "#8f8f8f")
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
LEVEL_DASHES = ("solid", "dash", "dashdot", "dot")
"""Of friction and resolution in a study."""
DASHES = ("solid", "dash", "dashdot", "longdash", "longdashdot", "dot")
"""As plotly names them; dotted is the truth's own, so it comes last."""
_KNOWN = ("welch_siso", "welch_full", "lpm_full", "direct", "mimo")


def estimator_tag(name: str) -> str:
    """Tag of everything that an estimator found."""
    return f"estimator:{name}"


def strokes(names: Iterable[str]) -> dict[str, Stroke]:
    """Strokes of estimators by name. Known ones always look alike, others get what is left."""
    wanted = list(names)
    order = [*_KNOWN, *(name for name in wanted if name not in _KNOWN)]
    numbers = {name: order.index(name) % len(DASHES) for name in wanted}
    return {
        name: Stroke(
            name=name,
            colour=f"--estimator-{number}",
            dash=DASHES[number],
            tags=[estimator_tag(name)],
        )
        for name, number in numbers.items()
    }


def joint_colour(joint: int) -> str:
    """Colour of a joint (0-based), a variable of the style."""
    return f"--joint-{joint % 7}"


def printed(colour: str) -> str:
    """Colour of a figure on paper, ``#rrggbb``, for a variable of the style."""
    name, _, number = colour.removeprefix("--").partition("-")
    return _PALETTES[name][int(number or 0)][0]


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
