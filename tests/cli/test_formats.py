"""`pipeline formats`: one row a format, all of them, and the programs whose files test it."""

import json
import re
from pathlib import Path

from pipeline.cli import main
from pipeline.formats.pvd import INDEX_SUFFIXES
from pipeline.formats.readers import READERS, find_format, is_temporal

PROGRAMS = {re.sub(r"\W|_", "", folder.name).lower() for folder in (Path(__file__).parents[1] / "programs").iterdir()}
ELSEWHERE = {"pyvista", "meshio", "medcoupling", "exovista"}  # files made in tests, or folders named by the format


def test_every_format_has_a_row(capsys):
    assert main(["formats", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    names = [name for row in rows for name in row["names"]]
    assert sorted(names) == sorted([*READERS, *INDEX_SUFFIXES]) and len(set(names)) == len(names)
    assert main(["formats"]) == 0
    table = capsys.readouterr().out
    assert len(table.splitlines()) == len(rows) + 1 and all(name in table for name in names)


def test_the_programs_of_the_tests_have_files(capsys):
    main(["formats", "--json"])
    for row in json.loads(capsys.readouterr().out):
        if row["tested_with"].startswith("none"):
            continue
        programs = {re.sub(r"\W", "", name).lower() for name in row["tested_with"].split(",")}
        assert programs <= PROGRAMS | ELSEWHERE, row


def test_a_package_that_is_missing_is_marked(capsys, monkeypatch):
    monkeypatch.setattr("pipeline.formats.format_table.find_spec", lambda name: None)
    main(["formats"])
    assert "adios2 (pip install adios2)" in capsys.readouterr().out


def test_formats_are_found_by_suffix_or_by_name():
    assert is_temporal(Path("a/d3plot")) and is_temporal(Path("B.E")) and not is_temporal(Path("a.vtu"))
    assert find_format(Path("a/d3plot.txt")) is None and find_format(Path("a/other")) is None


def test_the_page_has_every_format():
    page = (Path(__file__).parents[2] / "docs" / "formats.md").read_text()
    assert [name for name in (*READERS, *INDEX_SUFFIXES) if f"`{name}`" not in page] == []
