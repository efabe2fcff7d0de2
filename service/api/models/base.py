"""What the models share."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, WithJsonSchema

Json = dict[str, Any]

Number = Annotated[int | float, WithJsonSchema({"type": "number"})]
"""A number as the domain has it: an integer is not turned into a float on its way."""

Vector = Annotated[tuple[float, float, float], WithJsonSchema(
    {"type": "array", "items": {"type": "number"}, "minItems": 3, "maxItems": 3}
)]  # fmt: skip
"""Three numbers, along x, y and z."""

Attitude = Annotated[
    tuple[float, float, float, float],
    WithJsonSchema({"type": "array", "items": {"type": "number"}, "minItems": 4, "maxItems": 4}),
]
"""A quaternion w x y z."""

Stamp = Annotated[float, Field(description="wall-clock time, s since 1970")]


class Request(BaseModel):
    """The body of a request: a field that is not known is refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)
