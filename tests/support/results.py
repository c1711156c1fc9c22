"""Results and studies on disk, for tests of what displays them."""

import json
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from math import nan
from pathlib import Path

import numpy as np
from pydantic import TypeAdapter

from armimp_bringup.study import StudyEntry
from armimp_bringup.study.engine import Backend
from armimp_estimation.arm_models import ModelFit, ParameterFit
from armimp_estimation.bags.reader import read_bag
from armimp_estimation.metadata import Metadata
from armimp_estimation.result import conclude
from armimp_estimation.summary import EstimatorSummary
from support.bag_files import write_bag
from support.synthetic_bags import Message, recorded_arm
from support.synthetic_trials import TWO_JOINT_ARM

METADATA: Mapping[str, str] = {
    "config": json.dumps(
        {
            "experiment": {
                "joints": 2,
                "friction": 2,
                "resolution": 1,
                "perturbation": 3,
                "imbic_controller": {"law": {"gamma": 90.0}},
            },
            "arm_sim": {
                "arm.inertia": TWO_JOINT_ARM.M.ravel().tolist(),
                "friction.coulomb": [1.0, 1.0],
            },
            "imbic_controller": {"law.gamma": 90.0, "target.damping": [2.0, 1.0]},
            "versions": {"python": "3.12.0", "armimp": "0.1.0"},
            "git_revision": "0123abc",
        }
    ),
    "seed": "5",
    "gain_uncertainty": "0",
    "cross_talk_uncertainty": "0",
    "angle_uncertainty": "0",
    "truth": json.dumps({name: getattr(TWO_JOINT_ARM, name).tolist() for name in ("M", "B", "K")}),
}


def threads(workers: int) -> Backend:
    """Backend that runs the batches of a study in so many threads."""
    return Backend(ThreadPoolExecutor(workers), workers)


def read_study(path: Path) -> list[StudyEntry]:
    """Entries of ``study.json``."""
    return TypeAdapter(list[StudyEntry]).validate_json(path.read_bytes())


def with_cuff(one: EstimatorSummary) -> EstimatorSummary:
    """The summary of a two-joint estimate, with a model of which one value was not fitted."""
    matrices = {name: np.ravel(getattr(one, name)).tolist() for name in "MBK"}
    values = {**matrices, "cuff_stiffness": [2e5, 1e4], "delay": [0.01]}
    parameters = {
        name: ParameterFit(values=found, errors=[*[0.5] * (len(found) - 1), nan], unit="u")
        for name, found in values.items()
    }
    cuff = ModelFit(
        equation="A + B",
        parameters=parameters,
        lack_of_fit=one.lack_of_fit,
        held_out=1.0,
        criterion=1.0,
        fits=True,
    )
    return one.model_copy(update={"models": {"cuff": cuff}, "model": "cuff"})


def make_result(
    directory: Path,
    *,
    messages: Sequence[Message] | None = None,
    metadata: Mapping[str, str] = METADATA,
    estimators: Sequence[str] = ("welch_siso", "welch_full"),
) -> Path:
    """Record messages in ``bags/session``, conclude from them, and write the result."""
    bag = directory / "bags" / "session"
    write_bag(bag, recorded_arm().messages if messages is None else messages, metadata)
    content = read_bag(bag)
    conclude(
        [replace(trial, bag="bags/session") for trial in content.trials],
        known=Metadata.of(content.metadata),
        joint_names=content.joint_names,
        estimators=estimators,
    ).write(directory)
    return directory
