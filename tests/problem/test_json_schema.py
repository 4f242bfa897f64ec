"""The JSON Schema of case files: it accepts every shipped case, refuses what load_case refuses, and is committed."""

import json
import tomllib
from pathlib import Path

import jsonschema
import pytest

from pipeline.cli import main
from pipeline.errors import CaseError
from pipeline.problem import methods
from pipeline.problem.json_schema import case_schema, choice_table, iterate_keys, key_table
from tests.bodies import case_document, write_case

ROOT = Path(__file__).resolve().parents[2]
CASES = sorted((ROOT / "cases").glob("*.toml"))


@pytest.fixture(scope="module")
def validator():
    jsonschema.Draft202012Validator.check_schema(case_schema())
    return jsonschema.Draft202012Validator(case_schema())


@pytest.mark.parametrize("path", CASES, ids=lambda path: path.stem)
def test_the_schema_accepts_every_shipped_case(path, validator):
    assert [error.message for error in validator.iter_errors(tomllib.loads(path.read_text()))] == []


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("schedule", {"dt": -0.1, "frames": 3}),
        ("material", {"youngs_modulus": 1e6, "poisson_ratio": 0.5, "density": 1.0}),
        ("method", {"law": "hyperelastic"}),
        ("method", {"iterations": 0}),
        ("movie", {"size": [1280, 721]}),
        ("nonsense", 1),
    ],
)
def test_the_schema_refuses_what_a_case_refuses(key, value, validator, tmp_path):
    from pipeline import build, load_case

    document = case_document() | {key: value}
    assert list(validator.iter_errors(document))
    path = write_case(tmp_path, **{key: value})
    with pytest.raises(CaseError):
        build(load_case(path))


def test_every_key_has_a_sentence_and_every_number_a_unit_or_none():
    keys = dict(iterate_keys(case_schema()))
    assert {"schedule.dt", "loads.body_force.factor", "supports[].motion.spin.rate"} <= keys.keys()
    assert [key for key, entry in keys.items() if not entry.get("description")] == []
    assert keys["material.youngs_modulus"]["unit"] == "Pa"


def test_a_row_added_to_a_table_is_a_choice(monkeypatch, capsys):
    monkeypatch.setitem(methods.LAWS, "mine", methods.LawChoice(methods.LAWS["linear"].part, "a law of mine"))
    assert main(["methods"]) == 0
    assert "mine               a law of mine" in capsys.readouterr().out
    made = case_schema()
    assert "mine" in made["$defs"]["MethodSpec"]["properties"]["law"]["enum"]
    assert "mine" in made["properties"]["variants"]["additionalProperties"]["properties"]["method.law"]["enum"]


def test_the_command_prints_what_is_committed(capsys):
    assert main(["schema"]) == 0
    assert json.loads(capsys.readouterr().out) == json.loads((ROOT / "cases" / "case.schema.json").read_text())
    assert main(["schema", "--markdown"]) == 0
    printed = capsys.readouterr().out
    page = (ROOT / "docs" / "case_files.md").read_text()
    assert printed == f"{key_table()}\n{choice_table()}" and key_table() in page and choice_table() in page, (
        "write docs/case_files.md and cases/case.schema.json again: make schema"
    )


@pytest.mark.parametrize("path", CASES, ids=lambda path: path.stem)
def test_editors_find_the_schema(path):
    assert path.read_text().startswith("#:schema case.schema.json\n")
