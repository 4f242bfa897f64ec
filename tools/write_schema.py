"""Write cases/case.schema.json and the tables of docs/case_files.md from the specifications of case files."""

import json
import re
from pathlib import Path

from pipeline.problem.json_schema import case_schema, choice_table, key_table

ROOT = Path(__file__).resolve().parents[1]


def main() -> None:
    """Write both files."""
    (ROOT / "cases" / "case.schema.json").write_text(json.dumps(case_schema(), indent=2) + "\n", encoding="utf-8")
    page = ROOT / "docs" / "case_files.md"
    text = page.read_text(encoding="utf-8")
    for name, table in {"keys": key_table(), "choices": choice_table()}.items():
        pattern = rf"(<!-- {name}: [^>]*-->\n).*?(<!-- end of {name} -->)"
        text = re.sub(pattern, lambda match, table=table: f"{match[1]}\n{table}\n{match[2]}", text, flags=re.DOTALL)
    page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
