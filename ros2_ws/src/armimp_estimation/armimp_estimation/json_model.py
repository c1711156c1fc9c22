"""The base class of all models of JSON files: numbers may be null, unknown keys are refused."""

from __future__ import annotations

import math
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError, model_validator


def _nan_for_null(value: object) -> object:
    # Always the same NaN object, so that models that contain it can compare as equal.
    return math.nan if value is None or value != value else value  # noqa: PLR0124


def _list_of_array(value: object) -> object:
    return value.tolist() if isinstance(value, np.ndarray) else value


# JSON has no NaN or infinity: both are written as null, and null is read as NaN.
Number = Annotated[float, BeforeValidator(_nan_for_null)]
Vector = Annotated[list[Number], BeforeValidator(_list_of_array)]
Matrix = Annotated[list[list[Number]], BeforeValidator(_list_of_array)]


class JsonModel(BaseModel):
    """Model of a JSON file. Unknown keys are an error, as rewriting the file would lose them.

    Computed fields are written for other readers, and ignored when the file is read.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    @model_validator(mode="before")
    @classmethod
    def _without_computed(cls, given: Any) -> Any:
        if not isinstance(given, dict):
            return given
        return {key: value for key, value in given.items() if key not in cls.model_computed_fields}


def first_complaint(error: ValidationError) -> str:
    """Return the first error in a JSON file in one line: its place and the reason."""
    first = error.errors()[0]
    where = ".".join(map(str, first["loc"])) or "content"
    return f"{where}: {' '.join(first['msg'].removeprefix('Value error, ').split())}"
