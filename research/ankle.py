"""Ankle records of a person: M, B, K and a reflex from arrays, and whether their errors are honest.

``python -m research.ankle RECORD.npz...`` estimates each record as a whole and by quarters. A
record has ``angle`` (rad) and ``torque`` (N·m, applied to the foot) under random position
perturbation, and ``rate`` (Hz). Public ones of that kind, of a healthy subject, are in
``stiffnessID/experimental_data.mat`` of github.com/reklab/reklab_public (GPL-2); their torque is
that on the device, so ``--reverse`` turns it.

The rig imposes the angle, whatever the person does, so the angle is the input and there is no
feedback: ``direct`` is unbiased. Its scatter between quarters should be about its stated error.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

import armimp
from armimp_bringup import cli
from armimp_common.arrays import FloatArray
from armimp_common.errors import DataError
from armimp_estimation.arm_models import ModelFit
from armimp_estimation.identify import identify_records
from research.direct import Direct
from research.writing import print_table

PARTS = 4
SHOWN = ("M", "B", "K", "velocity_gain", "stretch_gain", "delay", "muscle")

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


def reflex_of(angle: FloatArray, torque: FloatArray, rate: float) -> ModelFit:
    """Fit the reflex model to the response from angle to torque."""
    moved = [(angle - angle.mean())[None]]
    recording = armimp.Recording.from_arrays(
        moved, [angle[None]], [torque[None]], rate=rate, timing="simultaneous"
    )
    known = recording.known.model_copy(update={"arm_model": "reflex"})
    found = identify_records([[one] for one in recording.trials], [Direct()], known)
    return found.estimators[Direct().name].models["reflex"]


def honesty(parts: list[ModelFit], name: str) -> float:
    """Return the scatter of a parameter between parts over its stated error."""
    values = np.array([one.parameters[name].values[0] for one in parts])
    errors = np.array([one.parameters[name].errors[0] for one in parts])
    return float(np.std(values, ddof=1) / np.sqrt(np.mean(errors**2)))


@app.command()
def ankle(
    records: Annotated[list[Path], typer.Argument(metavar="RECORD.npz...", help="Records.")],
    reverse: Annotated[bool, typer.Option("--reverse", help="Torque is on the device.")] = False,
) -> int:
    """Estimate the reflex model from ankle records, and compare quarters of each."""
    for path in records:
        try:
            with np.load(path) as content:
                angle, torque = (np.ravel(content[n]).astype(float) for n in ("angle", "torque"))
                rate = float(content["rate"])
        except Exception as cause:  # noqa: BLE001 (whatever a file that is no record leads to)
            raise DataError(f"{path}: no angle, torque and rate: {cause}") from None
        torque = -torque if reverse else torque
        size = angle.size // PARTS
        spans = [slice(k * size, (k + 1) * size) for k in range(PARTS)]
        fits = [reflex_of(angle[span], torque[span], rate) for span in (slice(None), *spans)]
        rows = []
        for name in SHOWN:
            cells = []
            for fit in fits:
                one = fit.parameters[name]
                value, error = one.values[0], one.errors[0]
                cells.append(f"{value:.4g} ± {error:.2g}" if error >= 0.0 else "–")
            ratio = honesty(fits[1:], name)
            rows.append((name, *cells, f"{ratio:.2f}" if np.isfinite(ratio) else "–"))
        parts = [f"quarter {k + 1}" for k in range(PARTS)]
        print_table(path.name, ("SI units", "whole", *parts, "scatter/error"), rows)
    return 0


if __name__ == "__main__":
    sys.exit(cli.main(sys.argv[1:], app, "research.ankle"))
