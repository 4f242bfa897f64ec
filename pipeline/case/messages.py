"""A validation error as one key and one line, with the nearest known key where one was mistyped."""

from collections.abc import Iterable, Iterator
from difflib import get_close_matches
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from pipeline.case.specs import CaseFile
from pipeline.case.values import as_toml, dotted
from pipeline.errors import quote_value

WANTED = {
    "model_type": "a table",
    "model_attributes_type": "a table",
    "dict_type": "a table",
    "tuple_type": "a list",
    "string_type": "a string",
}


def first_fault(error: ValidationError, overrides: Iterable[str] = ()) -> tuple[tuple[str, ...], str]:
    """The key and message of the first fault; unknown keys come first, as a misspelt key is also missing."""
    details = error.errors(include_url=False)
    detail = next((d for d in details if d["type"] == "extra_forbidden"), details[0])
    context: dict[str, Any] = detail.get("ctx", {})
    parts = tuple(str(part) for part in detail["loc"] if part != "[key]") + tuple(context.get("key", ()))
    match detail["type"]:
        case "extra_forbidden":
            whole = next((key for key in map(_parts, overrides) if key[: len(parts)] == parts), parts)
            whole = max(whole, parts, key=len)
            return whole, f"unknown key; {_remedy(parts, whole[len(parts) :])}"
        case "missing":
            return parts, "missing"
        case "case":
            return parts, str(context["message"])
        case kind if kind in WANTED:
            remedy = as_toml(detail["input"]) if kind == "tuple_type" else ""
            return parts, f"{quote_value(detail['input'])} is not {WANTED[kind]}{remedy}"
    return parts, " ".join(detail["msg"].split())


def blamed(parts: tuple[str, ...], variant: str, overrides: Iterable[str]) -> str:
    """The key to name for a fault in a variant: that of the override at fault, else the place itself."""
    for key in overrides:
        if parts[: len(_parts(key))] == _parts(key):
            return dotted(("variants", variant, key, *parts[len(_parts(key)) :]))
    for key in overrides:
        if _parts(key)[: len(parts)] == parts:
            return dotted(("variants", variant, key))
    return dotted(parts)


def _parts(key: str) -> tuple[str, ...]:
    return tuple(key.split("."))


def _remedy(parts: tuple[str, ...], rest: tuple[str, ...]) -> str:
    """What to write instead: a sibling spelt alike, the same word elsewhere, or one of all siblings."""
    *parent, word = parts
    siblings = list(_model_at(parent).model_fields)
    near = get_close_matches(word, siblings, n=1)
    if near:
        return f'did you mean "{dotted((*parent, near[0], *rest))}"?'
    elsewhere = [key for key in _keys(CaseFile) if _parts(key)[-1] == word]
    if elsewhere:
        return "did you mean " + " or ".join(f'"{key}"' for key in elsewhere) + "?"
    return f"known are {', '.join(siblings)}"


def _model_in(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((model for argument in get_args(annotation) if (model := _model_in(argument))), None)


def _model_at(parts: Iterable[str]) -> type[BaseModel]:
    model: type[BaseModel] = CaseFile
    for part in parts:
        if part in model.model_fields:
            model = _model_in(model.model_fields[part].annotation) or model
    return model


def _keys(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    """Every dotted key that is not inside a list."""
    for name, field in model.model_fields.items():
        yield prefix + name
        inner = _model_in(field.annotation)
        if inner and "tuple" not in str(field.annotation):
            yield from _keys(inner, f"{prefix}{name}.")
