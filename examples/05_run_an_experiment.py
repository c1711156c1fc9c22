"""Run an experiment through the node graph from Python, as `armimp run` does.

.venv/bin/python examples/05_run_an_experiment.py results/example
"""

import sys
from pathlib import Path

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.orchestrator import run_experiment
from armimp_common.status import Progress

directory = Path(sys.argv[1])  # must be new, or empty
config = ExperimentConfig(duration=10.0, estimators=("lpm_full",))
told: set[int] = set()


def tell(progress: Progress) -> None:
    """Say once for each trial that it runs; called a few times per second."""
    if progress.trial not in told:
        told.add(progress.trial)
        print(f"trial {progress.trial} of {progress.trials}: joint {progress.joint}")


summary = run_experiment(config, directory, on_progress=tell).summary

for one in summary.trials:
    print(f"joint {one.k}: {one.ticks} samples, {one.lost} lost, {one.rtf:.1f} x real time")
stiffness = summary.estimators["lpm_full"].K
print("K =", [[round(value, 3) for value in row] for row in stiffness], "N·m/rad")
print("valid" if summary.valid else summary.problems)
print("bags:", *sorted(path.name for path in (directory / "bags").iterdir()))
