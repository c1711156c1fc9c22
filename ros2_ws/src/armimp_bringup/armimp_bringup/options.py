"""Options of commands, made of the fields of models, so that each fact is told in one place."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Annotated, Any, TypeVar

import typer
from pydantic import BaseModel

_FunctionT = TypeVar("_FunctionT", bound=Callable[..., Any])
_MOST_CHOICES = 10
_TYPES: dict[str, Any] = {
    "integer": int,
    "number": float,
    "string": str,
    "boolean": bool,
    "array": list[str],
}
_FLAGS = {"estimators": "--estimator"}


def options_of(model: type[BaseModel], *names: str) -> Callable[[_FunctionT], _FunctionT]:
    """Give a command an option for each of these fields of a model, by default for all.

    Help, default and choices are those of the field; what has no type of an option is left out.
    The command gets None for what is not given, so that a configuration file prevails over a
    default.
    """
    properties = model.model_json_schema()["properties"]
    made = [_option(name, properties[name]) for name in names or properties]

    def decorate(function: _FunctionT) -> _FunctionT:
        signature = inspect.signature(function, eval_str=True)
        own = [
            one.replace(kind=inspect.Parameter.KEYWORD_ONLY)
            for one in signature.parameters.values()
            if one.kind is not inspect.Parameter.VAR_KEYWORD
        ]
        options = [one for one in made if one is not None]
        there = {one.name for one in options}
        parameters = [*options, *(one for one in own if one.name not in there)]
        setattr(function, "__signature__", signature.replace(parameters=parameters))  # noqa: B010
        return function

    return decorate


def _option(name: str, schema: dict[str, Any]) -> inspect.Parameter | None:
    described, default = schema.get("description", ""), schema.get("default")
    schema = {**schema, **next(iter(schema.get("anyOf", ())), {})}  # the first is not null
    kind: Any = _TYPES.get(schema["type"])
    if kind is None:
        return None
    choices = schema.get("enum", [])
    if kind is int and schema.get("maximum", 1e9) - schema.get("minimum", 0) <= _MOST_CHOICES:
        choices = range(schema["minimum"], schema["maximum"] + 1)
    shown: bool | str = False
    if isinstance(default, list):
        shown = " and ".join(default)
    elif default not in (None, "", False):
        shown = f"{default:g}" if isinstance(default, float) else str(default)
    option = typer.Option(
        _FLAGS.get(name, f"--{name.replace('_', '-')}"),
        help=described,
        show_default=shown,
        autocompletion=lambda: [str(one) for one in choices],
    )
    annotation: Any = Annotated[kind | None, option]
    return inspect.Parameter(
        name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=annotation
    )
