"""The JSON Schema of case files, for editors and docs: keys, units, choices, defaults and a sentence for each."""

from collections.abc import Iterator, Mapping
from typing import Any

from pipeline.case.keys import VARIANT_SECTIONS, CaseFile
from pipeline.problem.methods import describe_choices

_DIALECT = "https://json-schema.org/draft/2020-12/schema"
_OPEN = ("iterations",)  # keys whose choices include numbers, which an enumeration cannot list


def case_schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of a case file as plain Python values.

    Names of laws, steppers, shapes and the like come from the tables of problem/methods.py: a row added there is a
    choice here. The variants have every dotted key of the sections that a variant may change.
    """
    schema = _without_null(CaseFile.model_json_schema())
    for table in (schema, *schema["$defs"].values()):
        table["properties"] = {key: entry for key, entry in table["properties"].items() if "python" not in entry}
    definitions = schema["$defs"]
    for key, choices in describe_choices().items():
        section, _, name = key.partition(".")
        if name not in _OPEN:
            properties = _resolve(schema["properties"][section], definitions)["properties"]
            properties[name] |= {"enum": list(choices), "enumDescriptions": list(choices.values())}
    changes = {
        key: {name: entry[name] for name in ("description", "type", "enum", "$ref", "anyOf", "items") if name in entry}
        for key, entry in iterate_keys(schema)
        if key.split(".")[0] in VARIANT_SECTIONS and "[]" not in key
    }
    schema["properties"]["variants"]["additionalProperties"] = {"type": "object", "properties": changes}
    schema["anyOf"] = [{"required": ["material"]}, {"required": ["materials"]}]
    return {"$schema": _DIALECT, **schema, "title": "Case file of the volume-drift pipeline"}


def iterate_keys(schema: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the dotted key and the schema of every key of a case file; list entries have [] after the list's key."""

    def descend(properties: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, dict[str, Any]]]:
        for name, entry in properties.items():
            yield prefix + name, entry
            inner, mark = (entry["items"], "[]") if "$ref" in entry.get("items", {}) else (entry, "")
            table = _resolve(inner, schema["$defs"])
            if table is not inner:
                yield from descend(table["properties"], f"{prefix}{name}{mark}.")

    return descend(schema["properties"], "")


def key_table() -> str:
    """Return a Markdown table of all keys of a case file."""
    rows = ["| key | unit | default | meaning |", "| --- | --- | --- | --- |"]
    schema = case_schema()
    for key, entry in iterate_keys(schema):
        required = key.rpartition(".")[2] in _owner(key, schema).get("required", ())
        default = "required" if required else _show_default(entry)
        text = entry.get("description", "")
        if "enum" in entry:
            text += f"; one of {', '.join(f'`{name}`' for name in entry['enum'])}"
        rows.append(f"| `{key}` | {entry.get('unit', '')} | {default} | {text} |")
    return "\n".join(rows) + "\n"


def choice_table() -> str:
    """Return a Markdown table of the names that a case file can choose from, as `pipeline methods` prints them."""
    rows = ["| key | name | meaning |", "| --- | --- | --- |"]
    for key, choices in describe_choices().items():
        rows += [f"| `{key}` | `{name}` | {text} |" for name, text in choices.items()]
    return "\n".join(rows) + "\n"


def _show_default(entry: Mapping[str, Any]) -> str:
    """Return a default as TOML writes it, "" for a table, a list of tables or an optional key."""
    default = entry.get("default")
    if default is None or default in ([], {}) or isinstance(default, dict):
        return ""
    return f'`"{default}"`' if isinstance(default, str) else f"`{default}`"


def _resolve(entry: Mapping[str, Any], definitions: Mapping[str, Any]) -> Any:
    """Return the definition that an entry refers to, the entry itself if it refers to none."""
    references = [part["$ref"] for part in (entry, *entry.get("anyOf", ())) if "$ref" in part]
    return definitions[references[0].rpartition("/")[2]] if references else entry


def _owner(key: str, schema: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the schema of the table that a dotted key is in."""
    table: Mapping[str, Any] = schema
    for name in key.split(".")[:-1]:
        entry = table["properties"][name.removesuffix("[]")]
        table = _resolve(entry["items"] if name.endswith("[]") else entry, schema["$defs"])
    return table


def _without_null(node: Any) -> Any:
    """Return a schema in which an optional key has only its own type: TOML has no null. Titles are dropped too."""
    if isinstance(node, list):
        return [_without_null(item) for item in node]
    if not isinstance(node, dict):
        return node
    out = {key: _without_null(value) for key, value in node.items() if not (key == "title" and isinstance(value, str))}
    if "oneOf" in out:  # of types that cannot be mistaken for each other
        out["anyOf"] = out.pop("oneOf")
    kinds = [kind for kind in out.get("anyOf", ()) if kind != {"type": "null"}]
    kinds = [kind for kind in kinds if "python" not in kind] or kinds  # a file can have the others only
    if len(kinds) == 1:
        out = {**kinds[0], **{key: value for key, value in out.items() if key != "anyOf"}}
    elif kinds:
        out["anyOf"] = kinds
    if out.get("default", 0) is None:
        del out["default"]
    return out
