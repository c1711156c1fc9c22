"""Plots over frequency: impedance and coherence, with controls that switch estimators."""

from __future__ import annotations

from collections.abc import Callable

from armimp_estimation.report.controls import key, switch
from armimp_estimation.report.curves import coherence_curves, coherence_floor
from armimp_estimation.report.frequency_plots import (
    BANDS,
    TRUTH,
    bode_plot,
    coherence_plot,
    estimator_tag,
)
from armimp_estimation.report.html import Html, element, section
from armimp_estimation.report.look import MOTION_COLOUR, TORQUE_COLOUR, TRUTH_COLOUR, looks
from armimp_estimation.report.plots import Plot, frame
from armimp_estimation.report.result import Result
from armimp_estimation.results import Summary
from armimp_estimation.scores import coherence_significance
from armimp_estimation.verdict import Limits


def impedance_section(result: Result) -> Html | None:
    """Bode plots of all elements; None without curves."""
    if not result.curves:
        return None
    truth = result.summary.truth
    known = None if truth is None else truth.mbk()
    return section(
        "impedance",
        "Impedance over frequency",
        switches(result.summary),
        plot_matrix(result.summary.joints, lambda i, k: bode_plot(result.curves, known, i, k)),
    )


def coherence_section(result: Result) -> Html | None:
    """Coherences of all elements; None without spectra."""
    spectra = result.spectra
    if not spectra:
        return None
    averages = min(one.spectra.effective_averages for one in spectra.values())
    level = coherence_significance(averages, Limits().significance)

    n = result.summary.joints
    behind = {
        (i, k): coherence_curves(spectra[k], result.curves, i) for i in range(n) for k in spectra
    }
    floor = coherence_floor(behind.values())

    def plot(i: int, k: int) -> Plot | None:
        if (i, k) not in behind:
            return None
        return coherence_plot(behind[i, k], i, k, significance=level, floor=floor)

    return section(
        "coherence",
        "Coherence over frequency",
        element(
            "p",
            key(MOTION_COLOUR, "solid", "perturbation → angle of the perturbed joint"),
            key(TORQUE_COLOUR, "solid", "perturbation → torque"),
            key(TRUTH_COLOUR, "dotted", f"unrelated signals stay below {level:.2f} (95 %)"),
            class_="key",
        ),
        switches(result.summary, truth=False) if result.curves else None,
        plot_matrix(n, plot),
        element(
            "p",
            f"About {averages:.1f} independent averages. The coherence with the perturbation falls "
            "where friction, noise or voluntary torque compete with it. The derived coherence says "
            "how much of the torque the estimated impedance explains.",
            class_="note",
        ),
    )


def plot_matrix(joints: int, plot: Callable[[int, int], Plot | None]) -> Html:
    """Plots in the arrangement of the impedance matrix; rows: torque, columns: angle."""
    plots = [plot(i, k) for i in range(joints) for k in range(joints)]
    frames = (element("div") if one is None else frame(one) for one in plots)
    # A matrix that is too wide for the page would be harder to read than a list.
    columns = f"--columns:{joints}" if joints <= 3 else None
    return element("div", *frames, class_="matrix", style=columns)


def switches(summary: Summary, *, truth: bool = True) -> Html:
    """Controls that switch estimators, bands and truth in all plots of the page.

    Parameters
    ----------
    summary : Summary
        Of the result.
    truth : bool
        Whether to offer bands and truth, too.
    """
    styles = {"solid": "solid", "dot": "dotted"}
    boxes = [
        switch(estimator_tag(look.name), look.label, look.colour, styles.get(look.dash, "dashed"))
        for look in looks(summary.estimators).values()
    ]
    if truth:
        boxes.append(switch(BANDS, "95 % confidence bands", "#c3c9cf", "solid", wide=True))
        if summary.truth is not None:
            boxes.append(switch(TRUTH, "truth (simulation)", TRUTH_COLOUR, "dotted"))
    return element("fieldset", element("legend", "Show"), *boxes, class_="switches")
