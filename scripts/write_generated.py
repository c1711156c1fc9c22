"""Write what is generated: parameters, robot descriptions, message definitions, tables of pages."""

from __future__ import annotations

import enum
import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

from pydantic import BaseModel
from robot_description import robot_description
from rosbags.typesys import Stores, get_typestore

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.parameters import node_parameters
from armimp_common.schema import defaults, descriptions, flatten, leaves, to_params_yaml
from armimp_common.status import Progress, StoppingDecision, TimingFigures, TrialStatus
from armimp_common.topics import CONTROLLER_NODE, ESTIMATOR_NODE, SIM_NODE, TOPICS
from armimp_estimation.alignment.stream_statistics import StreamCount
from armimp_estimation.arm_models import ModelFit, ParameterFit
from armimp_estimation.fit import CommonDelay
from armimp_estimation.metadata import Timing
from armimp_estimation.parameters import EstimatorParameters
from armimp_estimation.problems import Problem
from armimp_estimation.summary import (
    EstimatorSummary,
    OriginSummary,
    Summary,
    TrialSummary,
    WallSummary,
)
from armimp_estimation.torque_timing import TorqueReading
from armimp_ros2_control.parameters import BridgeParameters
from armimp_sim.presets import JOINT_NAMES

ROOT = Path(__file__).resolve().parents[1]
SOURCES = Path("ros2_ws") / "src"
PAGE = Path("docs") / "interfaces.md"
_HEAD = "# Parameters of the default experiment; written by scripts/write_generated.py.\n"
_PACKAGES = {
    SIM_NODE: "armimp_sim",
    CONTROLLER_NODE: "armimp_control",
    ESTIMATOR_NODE: "armimp_estimation",
}
_KEYS: dict[str, Sequence[type[BaseModel]]] = {
    "## 4. Trial status": (TrialStatus,),
    "### Progress": (Progress,),
    "### Stopping decision": (StoppingDecision,),
    "### Timing in real time": (TimingFigures,),
    "### `summary.json`": (
        *(Summary, Problem, TrialSummary, StreamCount, EstimatorSummary, CommonDelay),
        *(ModelFit, ParameterFit, Timing, WallSummary, TorqueReading, OriginSummary),
    ),
}
"""Models by the heading of the page under which their keys are listed, in order of the tables."""
_MOST_CHOICES = 20
"""Most values of an enumeration that are listed with a key."""


def generated() -> dict[Path, str]:
    """Text of each file by its path below the root of the checkout."""
    # Metadata and directory of a particular run have no place in a default.
    models: dict[str, BaseModel] = {
        **node_parameters(ExperimentConfig(), None).by_node(),
        ESTIMATOR_NODE: EstimatorParameters(),
    }
    texts = {
        f"{_PACKAGES[node]}/config/{node}.yaml": _HEAD + to_params_yaml({node: model})
        for node, model in models.items()
    }
    # The bridge takes the place of the simulator, and so has its name.
    bridge = to_params_yaml({SIM_NODE: BridgeParameters()})
    texts["armimp_ros2_control/config/ros2_control_bridge.yaml"] = _HEAD + bridge
    for joints in JOINT_NAMES:
        texts[f"armimp_sim/urdf/armimp_{joints}_joints.urdf"] = robot_description(joints)
    texts["armimp_estimation/armimp_estimation/bags/message_definitions.json"] = _definitions()
    page = (ROOT / PAGE).read_text(encoding="utf-8")
    for node, model in models.items():
        table = parameter_table(model, given=node == CONTROLLER_NODE)
        page = _with_tables(page, f"### `{node}`", [table])
    for heading, kinds in _KEYS.items():
        page = _with_tables(page, heading, [key_table(kind) for kind in kinds])
    page = _with_contract(page)
    return {**{SOURCES / name: text for name, text in texts.items()}, PAGE: page}


def _definitions() -> str:
    """Definition and hash of each message type of the contract."""
    store = get_typestore(Stores.ROS2_JAZZY)
    definitions = {
        kind: {
            "text": store.generate_msgdef(kind, ros_version=2)[0],
            "hash": store.hash_rihs01(kind),
        }
        for kind in sorted({topic.type for topic in TOPICS.values()})
    }
    return json.dumps(definitions, indent=1) + "\n"


def _with_contract(page: str) -> str:
    """Fill in type and quality of service of each topic; the rest of its row stays as it is."""
    for topic, (kind, offered, _) in TOPICS.items():
        cell = r"[^|\n]+\|"
        reliability, durability = (one.replace("_", " ") for one in offered[1:])
        page, number = re.subn(
            rf"^(\| `{topic}` \|){cell}({cell}{cell}){cell}{cell}{cell}",
            rf"\1 `{kind}` |\2 {reliability} | {offered.depth} | {durability} |",
            page,
            flags=re.MULTILINE,
        )
        if number != 1:
            raise SystemExit(f"{PAGE}: {number} rows of {topic!r} with its quality of service")
    return page


def _with_tables(page: str, heading: str, tables: Sequence[str]) -> str:
    """Replace the tables under a heading, up to the next one, all of which must be there."""
    before, found, after = page.partition(f"\n{heading}\n")
    section, *rest = re.split(r"(?m)^(?=#)", after, maxsplit=1)
    new = iter(tables)
    section, number = re.subn(r"(?:^\|.*\n)+", lambda _: next(new, ""), section, flags=re.MULTILINE)
    if number != len(tables):
        raise SystemExit(f"{PAGE}: {number} tables under {heading!r}, not {len(tables)}")
    return "".join([before, found, section, *rest])


def key_table(model: type[BaseModel]) -> str:
    """Return the rows of the keys that a model has in a message or file."""
    told = descriptions(model)
    keys = {field.alias or name: told[name] for name, field in model.model_fields.items()}
    for name, field in model.model_fields.items():
        if choices := _choices(field.annotation):
            keys[field.alias or name] += f" {choices}"
    keys |= {name: one.description or "" for name, one in model.model_computed_fields.items()}
    rows = [f"| `{key}` | {' '.join(text.split())} |\n" for key, text in keys.items()]
    return "| key | value |\n|---|---|\n" + "".join(rows).replace("``", "`")


def _choices(kind: Any) -> str:
    """List the values of an enumeration, unless there are too many."""
    if not (isinstance(kind, type) and issubclass(kind, enum.Enum)):
        return ""
    values = [f"`{member.value}`" for member in kind if member.value]
    return f"One of {', '.join(values)}." if len(values) <= _MOST_CHOICES else ""


def parameter_table(model: BaseModel, *, given: bool) -> str:
    """Return the rows of a node's parameters, with the values of `model`.

    Parameters
    ----------
    model : parameters that are in force
    given : whether the user of the node has to set parameters without a default
    """
    kind, values = type(model), dict(flatten(model))
    optional = defaults(kind)
    rows = [
        "| parameter | type | default | range | meaning |",
        "|---|---|---|---|---|",
    ]
    for name, leaf in leaves(kind).items():
        value = f"`{json.dumps(_rounded(values[name]), ensure_ascii=False)}`"
        if given and name not in optional:
            value = f"required ({value})"
        row = (f"`{name}`", leaf.type_name, value, _range(kind, name), leaf.description)
        rows.append(f"| {' | '.join(row)} |")
    return "\n".join(rows) + "\n"


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, list | tuple):
        return [_rounded(item) for item in value]
    return value.value if isinstance(value, enum.Enum) else value


def _range(model: type[BaseModel], name: str) -> str:
    """Describe the permitted values of a parameter, from its field."""
    *groups, last = name.split(".")
    for group in groups:
        annotation = model.model_fields[group].annotation
        assert isinstance(annotation, type)
        model = annotation
    field = model.model_fields[last]
    kind: Any = field.annotation
    # The permitted items of an array are in the annotation of the item.
    items = [kind, *get_args(kind)] if get_origin(kind) is tuple else [kind]
    choices = [one for item in items if get_origin(item) is Literal for one in get_args(item)]
    if isinstance(kind, type) and issubclass(kind, enum.Enum):
        choices = [member.value for member in kind]
    bounds = [f"`{choice}`" for choice in choices]
    annotated = [item.__metadata__ for item in items if get_origin(item) is Annotated]
    for constraint in (
        *field.metadata,
        *(one for fields in annotated for one in fields[0].metadata),
    ):
        for attribute, sign in (("gt", ">"), ("ge", "≥"), ("lt", "<"), ("le", "≤")):
            if (value := getattr(constraint, attribute, None)) is not None:
                bounds.append(f"{sign} {value:g}")
    return ", ".join(bounds) or "–"


def main() -> None:
    """Write the files."""
    for name, text in generated().items():
        path = ROOT / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
