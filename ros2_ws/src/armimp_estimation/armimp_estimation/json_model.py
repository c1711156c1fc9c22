"""What the models of JSON files share: numbers that may be null, and no unknown keys."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import BaseModel, BeforeValidator, ConfigDict


def _nan_for_null(value: object) -> object:
    return math.nan if value is None else value


# JSON has no NaN or infinity: both are written as null, and null is read as NaN.
Number = Annotated[float, BeforeValidator(_nan_for_null)]
Vector = list[Number]
Matrix = list[Vector]


class JsonModel(BaseModel):
    """Unknown keys are an error: they would be lost when the file is written again."""

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)
