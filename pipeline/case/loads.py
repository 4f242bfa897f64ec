"""The keys of loads."""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

from pydantic import Discriminator, GetCoreSchemaHandler, GetJsonSchemaHandler, Tag, model_validator
from pydantic_core import CoreSchema
from pydantic_core.core_schema import no_info_before_validator_function

from pipeline.case.python_values import PythonValue
from pipeline.case.selectors import SelectorSpec
from pipeline.case.spec import Spec, about
from pipeline.case.values import TABLE, VECTOR, FiniteNumber, TimeFactor, Vector, VectorOrNumber, make_fault

_HISTORY = "factor as a function of t: an expression, or a table [[t, factor], ...]"


class TractionSpec(SelectorSpec):
    """A traction on the boundary faces whose nodes are all selected: along the normal, or a vector."""

    normal_traction: Annotated[
        FiniteNumber | None, about("traction along the outward normal of the rest surface", "Pa")
    ] = None
    traction: Annotated[Vector | None, about("traction as a vector, per rest area", "Pa")] = None
    history: Annotated[TimeFactor | None, about(_HISTORY)] = None

    @model_validator(mode="after")
    def _check_traction(self) -> "TractionSpec":
        if self.traction is None and self.normal_traction is None:
            raise make_fault("missing; give normal_traction, or traction as a vector", "normal_traction")
        if self.traction is not None and self.normal_traction is not None:
            raise make_fault("cannot be combined with normal_traction; write a second entry", "traction")
        return self


class PointLoadSpec(SelectorSpec):
    """A force at a point of the body, or on each of the selected nodes."""

    kinds: ClassVar[tuple[str, ...]] = ("at", *SelectorSpec.kinds)

    force: Annotated[Vector, about("force; on each node if nodes are selected", "N")]
    at: Annotated[
        VectorOrNumber | None,
        about("a point of the body at rest, as a vector; with plane, its position along the axis", "m"),
    ] = None  # type: ignore[assignment]  # a point is one more way to choose nodes
    history: Annotated[TimeFactor | None, about(_HISTORY)] = None

    def list_chosen(self) -> list[str]:
        """Return the keys that choose nodes; a vector is a point, a number the position of a plane."""
        return [*(["at"] if isinstance(self.at, tuple) else []), *super().list_chosen()]


class BodyForceSpec(Spec):
    """A force per volume."""

    value: Annotated[Vector, about("force per rest volume", "N/m3")]
    factor: Annotated[FiniteNumber, about("factor by which value is multiplied")] = 1.0
    history: Annotated[TimeFactor | None, about(_HISTORY)] = None


class GravitySpec(Spec):
    """Gravity that varies with time."""

    value: Annotated[Vector, about("acceleration due to gravity", "m/s2")]
    history: Annotated[TimeFactor | None, about(_HISTORY)] = None


class BareVector:
    """Annotation of a table that may be written as a bare vector, its `value`."""

    def check(self, value: Any) -> Any:
        """Return the table, made from the vector if only that is written."""
        return {"value": value} if isinstance(value, list | tuple) else value

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return no_info_before_validator_function(self.check, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        vector = {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 3}
        return {"anyOf": [vector, *handler(schema)["anyOf"]]}


VectorOrGravity = Annotated[
    Annotated[Vector, Tag(VECTOR)] | Annotated[GravitySpec, Tag(TABLE)],
    Discriminator(lambda value: TABLE if isinstance(value, Mapping | GravitySpec) else VECTOR),
]


class LoadsSpec(Spec):
    """Dead loads: they do not follow the deformation."""

    gravity: Annotated[
        VectorOrGravity | None,
        about("acceleration due to gravity: a vector, or a table with value and history", "m/s2"),
    ] = None
    body_force: Annotated[
        BodyForceSpec | None,
        BareVector(),
        about("force per rest volume: a vector, or a table with value, factor and history", "N/m3"),
    ] = None
    traction: Annotated[tuple[TractionSpec, ...], about("tractions on parts of the boundary")] = ()
    point: Annotated[tuple[PointLoadSpec, ...], about("forces at points or on nodes")] = ()
    body_force_field: Annotated[
        PythonValue | None, about("force per rest volume at the nodes, an array or a function of X and t", "N/m3")
    ] = None
    nodal_forces: Annotated[
        PythonValue | None, about("forces on the nodes, an array or a function of X and t", "N")
    ] = None
