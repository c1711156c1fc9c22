"""Names and colours of estimators and joints, the same in every report and figure.

The colours are those of Okabe and Ito, which colour-blind people can tell apart. Lines differ in
their dashes as well.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00")
_JOINTS = (*COLOURS, "#5f5f5f")
TRUTH_COLOUR = "#000000"
MOTION_COLOUR = "#8a8a8a"
"""Of the coherence of perturbation and angle."""
TORQUE_COLOUR = "#2b2b2b"
DASHES = ("solid", "dash", "dashdot", "longdash", "longdashdot", "dot")
"""As plotly names them; dotted is the truth's own, so it comes last."""
_KNOWN = ("welch_siso", "welch_full", "lpm_full", "direct", "mimo")
_LABELS = {
    "welch_siso": "Welch, single input",
    "welch_full": "Welch, full matrix",
    "lpm_full": "Local polynomial",
    "direct": "Direct",
    "mimo": "All joints at once",
}
_REMARKS = {
    "welch_siso": (
        "the paper's estimator, one ratio of spectra for each element. Its viscosity is biased: "
        "by the half-sample delay of the torque readings (+3 to +6 %), by leakage, and by motion "
        "of the locked joints."
    ),
    "welch_full": (
        "like the paper's, but with all columns at once, so that small motions of locked joints "
        "do no harm. Delay and leakage bias it all the same."
    ),
    "lpm_full": (
        "local polynomials instead of windows, which removes the leakage; the half-sample delay "
        "is corrected."
    ),
    "direct": "ignores the feedback loop; here for comparison, biased by voluntary torque.",
    "mimo": "from trials that perturb all joints at once; here for comparison.",
}


@dataclass(frozen=True, kw_only=True)
class Look:
    """How an estimator appears.

    Attributes
    ----------
    name : str
        In files and on the command line.
    label : str
        For people.
    remark : str
        What to know about it; empty if nothing is known.
    colour : str
        Of its lines, ``#rrggbb``.
    dash : str
        Of its lines, as plotly names it.
    """

    name: str
    label: str
    remark: str
    colour: str
    dash: str

    @property
    def pale(self) -> str:
        """Colour of confidence bands, as CSS has it."""
        red, green, blue = (int(self.colour[i : i + 2], 16) for i in (1, 3, 5))
        return f"rgba({red},{green},{blue},0.18)"


def looks(names: Iterable[str]) -> dict[str, Look]:
    """Looks of estimators by name. Known ones always look alike, others get what is left."""
    wanted = list(names)
    others = [name for name in wanted if name not in _KNOWN]
    order = [*_KNOWN, *others]
    return {
        name: Look(
            name=name,
            label=_LABELS.get(name, name),
            remark=_REMARKS.get(name, ""),
            colour=COLOURS[order.index(name) % len(COLOURS)],
            dash=DASHES[order.index(name) % len(DASHES)],
        )
        for name in wanted
    }


def joint_colour(joint: int) -> str:
    """Colour of a joint (0-based)."""
    return _JOINTS[joint % len(_JOINTS)]
