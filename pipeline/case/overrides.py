"""Overrides by dotted key, as `--set` and the variants of a case write them."""

import tomllib
from collections.abc import Mapping
from typing import Any

from pipeline.case.values import join_key
from pipeline.errors import CaseError, quote_value

# tables that may be written as vectors, their `value`, and the keys that turn a vector into such a table
_BARE_VECTORS = {("loads", "gravity"): ("value", "history"), ("loads", "body_force"): ("value", "factor", "history")}


def parse_override(text: str) -> tuple[str, object]:
    """Return the key and value of "key=value"; a value that is not TOML, such as a bare word, is a string."""
    key, equals, value = text.partition("=")
    key, value = key.strip(), value.strip()
    if not equals or not key:
        raise CaseError(f"--set {quote_value(text)}: write key=value, such as schedule.dt=0.01")
    try:
        table = tomllib.loads(f"value = {value}")
    except (ValueError, RecursionError):
        return key, value
    return key, table["value"] if len(table) == 1 else value


def apply_override(document: Mapping[str, Any], key: str, value: object) -> dict[str, Any]:
    """Return a copy of the document with a dotted key set; a table replaces a whole table. Raises ValueError."""
    if value is None:
        raise ValueError("None is not a TOML value")
    parts = key.split(".")
    if parts[0] == "variants":  # a variant's name is followed by one dotted key
        parts = [*parts[:2], *filter(None, [".".join(parts[2:])])]
    return dict(_replace_at(document, parts, value, ()))


def list_dropped_keys(document: Mapping[str, Any], key: str, value: object) -> list[str]:
    """Return the keys that are lost if an override replaces a whole table."""
    node: Any = document
    for part in key.split("."):
        node = node.get(part) if isinstance(node, Mapping) else None
    if not (isinstance(node, Mapping) and isinstance(value, Mapping)):
        return []
    return [name for name in node if name not in value]


def _replace_at(node: Any, parts: list[str], value: object, done: tuple[str, ...]) -> Any:
    if not parts:
        return value
    head, *rest = parts
    if isinstance(node, Mapping):
        return {**node, head: _replace_at(node.get(head, {}), rest, value, (*done, head))}
    if done in _BARE_VECTORS and isinstance(node, list | tuple) and head in _BARE_VECTORS[done]:
        return {"value": node, head: _replace_at({}, rest, value, (*done, head)) if rest else value}
    if isinstance(node, list | tuple):
        index = int(head) if head.isascii() and head.isdecimal() and len(head) < 10 else -1
        if not 0 <= index < len(node):
            has = f"entries 0 to {len(node) - 1}" if node else "no entries"
            raise ValueError(f"{join_key(done)} is a list with {has}; it has no {quote_value(head)}")
        return [*node[:index], _replace_at(node[index], rest, value, (*done, head)), *node[index + 1 :]]
    raise ValueError(f"{join_key(done)} is {quote_value(node)}, not a table")
