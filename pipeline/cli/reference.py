"""`pipeline schema`: the reference of case files."""

import argparse
import json
from typing import Any

from pipeline.cli.options import SharedOptions


def add_verbs(verbs: Any, shared: SharedOptions) -> None:
    """Add the verb `schema`."""
    schema = verbs.add_parser(
        "schema", parents=[shared.common], help="print the JSON Schema of case files, for editors"
    )
    schema.add_argument("--markdown", action="store_true", help="print tables of all keys and choices instead")
    schema.set_defaults(run=_schema)


def _schema(options: argparse.Namespace) -> int:
    from pipeline.problem.json_schema import case_schema, choice_table, key_table

    if options.markdown:
        print(f"{key_table()}\n{choice_table()}", end="")
    else:
        print(json.dumps(case_schema(), indent=2))
    return 0
