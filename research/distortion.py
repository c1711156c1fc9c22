"""Whether a multisine distinguishes nonlinear or time-varying arms from linear, constant ones.

Runs of the project's own rig at levels 3/3/3 with a multisine, flat or optimal: a constant linear
arm, one with a cubic spring that changes the shoulder's stiffness by 5 % from rest to the rms
angle, and one whose stiffness changes by 5 % over each trial; and a linear one on the realistic
rig, with the torque of a person.
"""

from __future__ import annotations

import collections
import itertools
from collections.abc import Mapping
from typing import Literal, TypeAlias

from pydantic import JsonValue

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.study import parse_seeds
from armimp_common.errors import ConfigurationError
from armimp_control.perturbation import PerturbationKind
from armimp_estimation.problems import ProblemCode
from research.decomposition_trials import identified
from research.options import InvestigationOptions

CODES = {
    ProblemCode.DEPENDS_ON_AMPLITUDE,
    ProblemCode.TORQUE_NOT_LINEAR,
    ProblemCode.HYSTERESIS,
    ProblemCode.CHANGES_OVER_TIME,
}
Rig: TypeAlias = Literal["paper", "realistic"]
RMS_ANGLE = 0.045
CUBIC = 0.05 / (3.0 * RMS_ANGLE**2)
"""Coefficient c of the torque K c x³, whose slope is 3 K c x², 1/rad²."""
ARMS: dict[str, tuple[Rig, Mapping[str, JsonValue], ProblemCode | None]] = {
    "linear": ("paper", {}, None),
    "cubic": ("paper", {"muscle.cubic": CUBIC}, ProblemCode.DEPENDS_ON_AMPLITUDE),
    "drift": ("paper", {"muscle.stiffening": 0.05 / 50.0}, ProblemCode.CHANGES_OVER_TIME),
    "realistic": ("realistic", {}, None),
}
KINDS: tuple[PerturbationKind, ...] = ("multisine", "optimal")


def investigate(options: InvestigationOptions) -> int:
    """Print how many runs of each arm are flagged, and as what; returns exit status 0."""
    seeds = parse_seeds(options.seeds or "0:40")
    cases = [one for one in itertools.product(KINDS, ARMS) if options.only in " ".join(one)]
    if not cases:
        raise ConfigurationError(f"--only {options.only}: there is no such case")
    for kind, arm in cases:
        rig, changes, code = ARMS[arm]
        flagged, valid = 0, 0
        found: collections.Counter[str] = collections.Counter()
        configs = [
            ExperimentConfig(perturbation_kind=kind, rig=rig, seed=seed, arm_sim=dict(changes))
            for seed in seeds
        ]
        for _, result in identified(configs, options.workers):
            codes = {problem.code for problem in result.problems} & CODES
            flagged += bool(codes) if code is None else code in codes
            valid += result.valid
            found.update(one.value for one in codes)
        what = "anything" if code is None else code.value
        print(f"{kind} {arm}: {flagged} of {len(seeds)} show {what}, {valid} valid; {dict(found)}")
    return 0
