"""Declarative parameter schemas: one frozen pydantic model for each node, without ROS.

A field becomes one ROS parameter, which the docstring below it describes; the fields of a nested
model become dotted names::

    class Law(Schema):
        gamma: float = Field(default=100.0, gt=0.0)
        "Velocity feedback gain (rad/s)."


    class ControllerParameters(Schema):
        law: Law = Law()  # parameter "law.gamma"
        joints: tuple[str, ...] = ("shoulder", "elbow")  # parameter "joints"
"""

import ast
import difflib
import enum
import functools
import itertools
import json
import linecache
import math
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Final, Literal, TypeAlias, TypeVar

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.fields import FieldInfo

from armimp_common.errors import ConfigurationError

Value: TypeAlias = bool | int | float | str | list[bool] | list[int] | list[float] | list[str]
Vector: TypeAlias = tuple[float, ...]
"""One value for each joint, one for all of them, or a matrix row by row, as the field says."""
PositiveVector: TypeAlias = tuple[Annotated[float, Field(gt=0.0)], ...]
NonNegativeVector: TypeAlias = tuple[Annotated[float, Field(ge=0.0)], ...]
Signs: TypeAlias = tuple[Literal[1, -1], ...]
ModelT = TypeVar("ModelT", bound=BaseModel)

_DEEPEST: Final = 50
_MOST_NODES: Final = 250_000
_WIDEST: Final = 2**31 - 1
"""Limits of YAML: depth and number of nodes that are read, and width of a line that is written."""

Loader: Final[Any] = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
TextLoader: Final[Any] = getattr(yaml, "CBaseLoader", yaml.BaseLoader)
"""Loads every value as a string: what is written stays as it is."""

_TYPES: Final = {"boolean": "bool", "integer": "integer", "number": "double", "string": "string"}
"""Types of ROS parameters by those of JSON schemas."""


class Schema(BaseModel):
    """Base for parameter schemas: frozen, no unknown keys, no NaN or infinity anywhere."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, validate_default=True
    )


@dataclass(frozen=True, kw_only=True)
class Leaf:
    """One parameter of a schema."""

    name: str
    """Dotted name."""
    type_name: str
    """The type as ROS names it: ``double``, ``string array``..."""
    description: str
    """Meaning of the parameter."""
    minimum: float
    maximum: float
    """Bounds of the allowed numbers, which may or may not include them; infinite: no bound."""

    @property
    def array(self) -> bool:
        """Whether the value is a sequence."""
        return self.type_name.endswith(" array")


@functools.cache
def leaves(model: type[BaseModel]) -> dict[str, Leaf]:
    """Return the parameters of a schema by dotted name, in the order of its fields.

    Raises
    ------
    TypeError
        If a field has a type that ROS parameters cannot have.
    """
    schema = model.model_json_schema()
    return {leaf.name: leaf for leaf in _leaves(model, schema, schema.get("$defs", {}), "")}


def _leaves(
    model: type[BaseModel], schema: Mapping[str, Any], known: Mapping[str, Any], prefix: str
) -> Iterator[Leaf]:
    """Yield leaves of a model from its JSON schema; those of nested types are in ``known``."""
    described = descriptions(model)
    for key, field in model.model_fields.items():
        spec = schema["properties"][key]
        spec = {**spec, **known.get(spec.get("$ref", "").rpartition("/")[2], {})}
        if (sub_model := _sub_model(field)) is not None:
            yield from _leaves(sub_model, spec, known, f"{prefix}{key}.")
            continue
        array = spec.get("type") == "array"
        item = (spec.get("items", {}) if array else spec).get("type")
        if item not in _TYPES:
            raise TypeError(
                f"{model.__name__}.{key}: ROS parameters cannot have type {field.annotation}"
            )
        low = spec.get("minimum", spec.get("exclusiveMinimum", -math.inf))
        high = spec.get("maximum", spec.get("exclusiveMaximum", math.inf))
        yield Leaf(
            name=f"{prefix}{key}",
            type_name=_TYPES[item] + (" array" if array else ""),
            description=described[key],
            minimum=float(low),
            maximum=float(high),
        )


def descriptions(model: type[BaseModel]) -> dict[str, str]:
    """Return the meaning of each field of a model: the docstring below it, or its description."""
    found = {name: field.description or "" for name, field in model.model_fields.items()}
    for kind in reversed(model.__mro__[: model.__mro__.index(BaseModel)]):
        found |= _docstrings(kind.__module__).get(kind.__name__, {})
    return found


@functools.cache
def _docstrings(module: str) -> dict[str, dict[str, str]]:
    """Return the docstrings of attributes by class and name, for all classes of a module.

    The option `use_attribute_docstrings` of pydantic does the same, at 4 ms a class for each start.
    """
    file = getattr(sys.modules[module], "__file__", None) or ""
    return {
        kind.name: {
            field.target.id: " ".join(below.value.value.split())
            for field, below in itertools.pairwise(kind.body)
            if isinstance(field, ast.AnnAssign)
            and isinstance(field.target, ast.Name)
            and isinstance(below, ast.Expr)
            and isinstance(below.value, ast.Constant)
            and isinstance(below.value.value, str)
        }
        for kind in ast.parse("".join(linecache.getlines(file))).body
        if isinstance(kind, ast.ClassDef)
    }


def defaults(model: type[BaseModel]) -> dict[str, Value]:
    """Return the default values of a schema by dotted name, for the fields that have one."""
    found = dotted(model.model_construct().model_dump(mode="json"))
    for key, field in model.model_fields.items():
        sub_model = _sub_model(field)
        if sub_model is not None and field.is_required():
            found |= {f"{key}.{name}": value for name, value in defaults(sub_model).items()}
    return found


def flatten(instance: BaseModel) -> dict[str, Value]:
    """Return the values of a schema instance by dotted name; tuples become lists."""
    return dotted(instance.model_dump(mode="json"))


def dotted(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return the values of nested mappings by dotted name."""
    found: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, Mapping):
            found |= dotted(value, f"{prefix}{name}.")
        else:
            found[f"{prefix}{name}"] = value
    return found


def build(model: type[ModelT], values: Mapping[str, object]) -> ModelT:
    """Return an instance with these values, by dotted name, and defaults for the rest.

    Integers may stand for doubles, and None for an empty array, for which ROS has no type.

    Raises
    ------
    ConfigurationError
        On an unknown name, a wrong type, or a value that the schema refuses.
    """
    known = leaves(model)
    check_names(values, known)
    nested: dict[str, Any] = {}
    for name, value in values.items():
        *path, last = name.split(".")
        branch = nested
        for key in path:
            branch = branch.setdefault(key, {})
        branch[last] = [] if value is None and known[name].array else _plain(name, value)
    try:
        # Validation from JSON is strict about types, and yet takes a list for any sequence.
        return model.model_validate_json(json.dumps(nested), strict=True)
    except ValidationError as error:
        raise ConfigurationError(explain(error)) from None


def _plain(name: str, value: object) -> object:
    """Convert a value of a parameter to what JSON can hold."""
    if isinstance(value, enum.Enum):
        return value.value
    if isinstance(value, int) and not -(2**63) <= value < 2**63:
        raise ConfigurationError(f"parameter '{name}' = {_shown(value)}: is too large")
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, Iterable) and not isinstance(value, bytes | Mapping):
        return [_plain(name, item) for item in value]
    raise ConfigurationError(f"parameter '{name}' = {_shown(value)}: no parameter has such a type")


def require_length(name: str, values: Sequence[Any], n: int, *lengths: int) -> None:
    """Check that the number of values of a parameter, of a rig with `n` joints, is in `lengths`.

    Raises
    ------
    ConfigurationError
        If it is not.
    """
    if len(values) not in lengths:
        raise ConfigurationError(
            f"parameter '{name}' has {len(values)} values for {n} joints, needs "
            f"{' or '.join(map(str, lengths))}"
        )


def each(name: str, values: Sequence[Any], n: int) -> NDArray[Any]:
    """Return the values (n,) of a parameter that has one for all `n` joints, or one for each.

    Raises a ConfigurationError if it has another number of values.
    """
    require_length(name, values, n, 1, n)
    return np.resize(np.array(values), n)


def matrix(name: str, values: Vector, n: int) -> NDArray[np.float64]:
    """Return the matrix (n, n) that a parameter of `n` joints holds row by row.

    Raises a ConfigurationError if it has another number of values.
    """
    require_length(name, values, n, n * n)
    return np.array(values).reshape(n, n)


def row_by_row(values: NDArray[np.float64]) -> Vector:
    """Return the values of a vector (n,), or of a matrix row by row, as parameters hold them."""
    return tuple(values.ravel().tolist())


def check_names(names: Iterable[str], known: Iterable[str]) -> None:
    """Check that every name is known.

    Raises
    ------
    ConfigurationError
        If one is not; the message has the first such name, and a similar valid one if there is one.
    """
    valid = list(known)
    for name in names:
        if name not in valid:
            # Case is ignored: a slip in it is common, and would count as many wrong characters.
            by_folded = {other.lower(): other for other in valid}
            near = difflib.get_close_matches(name.lower(), list(by_folded), n=1)
            hint = f"; the nearest valid name is '{by_folded[near[0]]}'" if near else ""
            raise ConfigurationError(f"parameter '{name}' does not exist{hint}")


def explain(error: ValidationError) -> str:
    """Return pydantic's first complaint on one line: the parameter, its value, and why."""
    first = error.errors(include_url=False)[0]
    name = "".join(f"[{p}]" if isinstance(p, int) else f".{p}" for p in first["loc"])
    name = name.removeprefix(".")
    reason = first["msg"].removeprefix("Value error, ").removeprefix("Assertion failed, ")
    reason = " ".join(reason.split())
    if first["type"] == "missing":
        return f"parameter '{name}' is missing"
    if first["type"] == "extra_forbidden":
        return f"parameter '{name}' does not exist"
    if not name:
        return f"parameters do not fit together: {reason}"
    if isinstance(first["input"], Mapping | BaseModel):
        return f"parameters '{name}' do not fit together: {reason}"
    return f"parameter '{name}' = {_shown(first['input'])}: {reason[:1].lower()}{reason[1:]}"


class _Dumper(getattr(yaml, "CSafeDumper", yaml.SafeDumper)):  # type: ignore[misc]
    """Writes each list on one line, and all text but keys in quotes, so that it is read as text."""

    def represent_list(self, items: list[Any]) -> Any:
        return self.represent_sequence("tag:yaml.org,2002:seq", items, flow_style=True)

    def represent_str(self, text: str) -> Any:
        return self.represent_scalar("tag:yaml.org,2002:str", text, style='"')

    def represent_mapping(self, *arguments: Any, **options: Any) -> Any:
        node = super().represent_mapping(*arguments, **options)
        for key, _ in node.value:
            key.style = None
        return node


_Dumper.add_representer(list, _Dumper.represent_list)
_Dumper.add_representer(str, _Dumper.represent_str)


def to_params_yaml(models: Mapping[str, BaseModel]) -> str:
    """Return the text of a file for ``--params-file``.

    Parameters
    ----------
    models : values by the name of the node, with its namespace if it has one
    """
    content = {
        node: {"ros__parameters": model.model_dump(mode="json")} for node, model in models.items()
    }
    text: str = yaml.dump(content, Dumper=_Dumper, sort_keys=False, width=_WIDEST)
    return text


def load_yaml(text: str, loader: Any = Loader, *, aliases: bool = False) -> Any:
    """Load a YAML document, unless it is too deep, too large, or has aliases.

    Parameters
    ----------
    text : the document
    loader : a loader of PyYAML
    aliases : whether aliases are allowed; with them, a few lines may unfold to more than any memory
        holds, in a loader that merges mappings or for code that walks through the result

    Raises
    ------
    yaml.YAMLError
        If it is no YAML, nested too deeply or too large, or has an alias that is not allowed.
    """
    depth = nodes = 0
    for event in yaml.parse(text, Loader=loader):
        nodes += isinstance(event, yaml.NodeEvent)
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > _DEEPEST:
            # The loader in C ends the process when it runs out of stack.
            raise yaml.YAMLError("it is nested too deeply")
        if nodes > _MOST_NODES:
            raise yaml.YAMLError(f"it has more than {_MOST_NODES} values")
        if isinstance(event, yaml.AliasEvent) and not aliases:
            raise yaml.YAMLError(f"the alias *{event.anchor:.40} is not allowed")
    return yaml.load(text, Loader=loader)


def _sub_model(field: FieldInfo) -> type[BaseModel] | None:
    annotation = field.annotation
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return None


def _shown(value: object) -> str:
    text = json.dumps(value) if isinstance(value, str) else str(value)
    return text if len(text) <= 80 else f"{text[:77]}..."
