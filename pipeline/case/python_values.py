"""Arrays and functions in a case that was made in Python; files carry only their descriptions."""

from typing import Annotated, Any

from pydantic import Discriminator, GetCoreSchemaHandler, GetJsonSchemaHandler, Tag
from pydantic_core import CoreSchema
from pydantic_core.core_schema import no_info_plain_validator_function

from pipeline.case.values import PYTHON, VECTOR, Vector, make_fault
from pipeline.errors import quote_value

_KINDS = ("array ", "function ")


class PythonValue:
    """An array or a function, and the description that stands for it in files and in comparisons of settings.

    `value` is None if the case was read back from a result folder.
    """

    def __init__(self, description: str, value: Any = None) -> None:
        self.description = description
        self.value = value

    def __repr__(self) -> str:
        return f"<{self.description}>"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, PythonValue) and other.description == self.description

    def __hash__(self) -> int:
        return hash(self.description)

    @classmethod
    def check(cls, value: Any) -> "PythonValue":
        """Return the value, or one made from its description if that is all there is."""
        if isinstance(value, str) and value.startswith(_KINDS):
            return cls(value)
        if not isinstance(value, cls):
            raise make_fault(f"{quote_value(value)} is neither an array nor a function; only make_case takes those")
        return value

    @classmethod
    def __get_pydantic_core_schema__(cls, _source: Any, _handler: GetCoreSchemaHandler) -> CoreSchema:
        return no_info_plain_validator_function(cls.check)

    @classmethod
    def __get_pydantic_json_schema__(cls, _schema: CoreSchema, _handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {"type": "string", "python": True}  # case files have no such key, so the schema leaves it out


VectorOrPython = Annotated[
    Annotated[Vector, Tag(VECTOR)] | Annotated[PythonValue, Tag(PYTHON)],
    Discriminator(lambda value: PYTHON if isinstance(value, PythonValue | str) else VECTOR),
]
