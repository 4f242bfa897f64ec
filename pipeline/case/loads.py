"""The keys of loads."""

from typing import Annotated, Any

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import CoreSchema
from pydantic_core.core_schema import no_info_before_validator_function

from pipeline.case.python_values import PythonValue
from pipeline.case.selectors import SelectorSpec
from pipeline.case.spec import Spec, about
from pipeline.case.values import FiniteNumber, Vector


class TractionSpec(SelectorSpec):
    """A traction on the boundary faces whose nodes are all selected."""

    normal_traction: Annotated[FiniteNumber, about("traction along the outward normal of the rest surface", "Pa")]


class BodyForceSpec(Spec):
    """A force per volume."""

    value: Annotated[Vector, about("force per rest volume", "N/m3")]
    factor: Annotated[FiniteNumber, about("factor by which value is multiplied")] = 1.0


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


class LoadsSpec(Spec):
    """Dead loads: they do not follow the deformation."""

    gravity: Annotated[Vector | None, about("acceleration due to gravity", "m/s2")] = None
    body_force: Annotated[
        BodyForceSpec | None,
        BareVector(),
        about("force per rest volume: a vector, or a table with value and factor", "N/m3"),
    ] = None
    traction: Annotated[tuple[TractionSpec, ...], about("tractions on parts of the boundary")] = ()
    body_force_field: Annotated[
        PythonValue | None, about("force per rest volume at the nodes, an array or a function of X and t", "N/m3")
    ] = None
    nodal_forces: Annotated[
        PythonValue | None, about("forces on the nodes, an array or a function of X and t", "N")
    ] = None
