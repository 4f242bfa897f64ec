"""A table of a case file, and the metadata of a key."""

from pydantic import BaseModel, ConfigDict, Field
from pydantic.fields import FieldInfo


def about(description: str, unit: str | None = None) -> FieldInfo:
    """Return the metadata of a key: its sentence and its unit, for the JSON Schema and the docs."""
    extra = None if unit is None else {"unit": unit}
    return Field(description=description, json_schema_extra=extra)  # type: ignore[arg-type]  # its JSON type is invariant


class Spec(BaseModel):
    """A table of the case file: frozen, with known keys only."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    def derived_keys(self) -> frozenset[str]:
        """Return the attributes that follow from others and so are not written to a file."""
        return frozenset()
