"""`pipeline schema` and `pipeline formats`: the reference of case files, and of the files of series."""

import argparse
import json
from typing import Any

from pipeline.cli.options import SharedOptions


def add_verbs(verbs: Any, shared: SharedOptions) -> None:
    """Add the verbs `schema` and `formats`."""
    schema = verbs.add_parser(
        "schema", parents=[shared.common], help="print the JSON Schema of case files, for editors"
    )
    schema.add_argument("--markdown", action="store_true", help="print tables of all keys and choices instead")
    schema.set_defaults(run=_schema)
    formats = verbs.add_parser("formats", parents=[shared.common], help="list the files that series are read from")
    formats.add_argument("--json", action="store_true", help="print them as JSON")
    formats.set_defaults(run=_formats)


def _schema(options: argparse.Namespace) -> int:
    from pipeline.problem.json_schema import case_schema, choice_table, key_table

    if options.markdown:
        print(f"{key_table()}\n{choice_table()}", end="")
    else:
        print(json.dumps(case_schema(), indent=2))
    return 0


def _formats(options: argparse.Namespace) -> int:
    from pipeline.formats.format_table import encode_table, list_rows

    rows = list_rows()
    print(json.dumps([row._asdict() for row in rows], indent=2) if options.json else encode_table(rows), end="\n")
    return 0
