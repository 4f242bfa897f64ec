"""A validation error as one key and one line, with the nearest known key if one was misspelled."""

from collections.abc import Iterable, Iterator
from difflib import get_close_matches
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from pipeline.case.keys import CaseFile
from pipeline.case.values import MARKS, join_key, suggest_toml
from pipeline.errors import quote_value

WANTED = {
    "model_type": "a table",
    "model_attributes_type": "a table",
    "dict_type": "a table",
    "tuple_type": "a list",
    "string_type": "a string",
}


def describe_first_fault(error: ValidationError, overrides: Iterable[str] = ()) -> tuple[tuple[str, ...], str]:
    """Return the key and message of the first fault; unknown keys come first, as one misspelled is also missing."""
    details = error.errors(include_url=False)
    detail = next((d for d in details if d["type"] == "extra_forbidden"), details[0])
    context: dict[str, Any] = detail.get("ctx", {})
    parts = tuple(str(part) for part in detail["loc"] if part not in ("[key]", *MARKS)) + tuple(context.get("key", ()))
    match detail["type"]:
        case "extra_forbidden":
            whole = next((key for key in map(_split_key, overrides) if key[: len(parts)] == parts), parts)
            whole = max(whole, parts, key=len)
            return whole, f"unknown key; {_suggest_key(parts, whole[len(parts) :])}"
        case "missing":
            return parts, "missing"
        case "case":
            return parts, str(context["message"])
        case kind if kind in WANTED:
            remedy = suggest_toml(detail["input"]) if kind == "tuple_type" else ""
            return parts, f"{quote_value(detail['input'])} is not {WANTED[kind]}{remedy}"
    return parts, " ".join(detail["msg"].split())


def name_faulty_key(parts: tuple[str, ...], variant: str, overrides: Iterable[str]) -> str:
    """Return the key to name for a fault in a variant: the override that caused it, else the faulty key itself."""
    for key in overrides:
        if parts[: len(_split_key(key))] == _split_key(key):
            return join_key(("variants", variant, key, *parts[len(_split_key(key)) :]))
    for key in overrides:
        if _split_key(key)[: len(parts)] == parts:
            return join_key(("variants", variant, key))
    return join_key(parts)


def _split_key(key: str) -> tuple[str, ...]:
    return tuple(key.split("."))


def _suggest_key(parts: tuple[str, ...], rest: tuple[str, ...]) -> str:
    """Return a suggestion: a sibling with a similar spelling, the same word elsewhere, or the list of all siblings."""
    *parent, word = parts
    siblings = list(_model_at_key(parent).model_fields)
    near = get_close_matches(word, siblings, n=1)
    if near:
        return f'did you mean "{join_key((*parent, near[0], *rest))}"?'
    elsewhere = [key for key in _iterate_keys(CaseFile) if _split_key(key)[-1] == word]
    if elsewhere:
        return "did you mean " + " or ".join(f'"{key}"' for key in elsewhere) + "?"
    return f"choose from {', '.join(siblings)}"


def _find_model(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((model for argument in get_args(annotation) if (model := _find_model(argument))), None)


def _model_at_key(parts: Iterable[str]) -> type[BaseModel]:
    model: type[BaseModel] = CaseFile
    for part in parts:
        if part in model.model_fields:
            model = _find_model(model.model_fields[part].annotation) or model
    return model


def _iterate_keys(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    """Yield every dotted key that is not inside a list."""
    for name, field in model.model_fields.items():
        yield prefix + name
        inner = _find_model(field.annotation)
        if inner and "tuple" not in str(field.annotation):
            yield from _iterate_keys(inner, f"{prefix}{name}.")
