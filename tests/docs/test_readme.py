"""The Python of README.md runs as it stands there, and its types are right."""

import os
import re
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def python_example() -> str:
    section = (ROOT / "README.md").read_text(encoding="utf-8").partition("### From Python")[2]
    return textwrap.dedent(re.search(r"\n\n((?:    .*\n|\n)+)", section)[1])


@pytest.mark.slow
def test_the_example_runs(tmp_path):
    script = tmp_path / "example.py"
    script.write_text(python_example() + "assert len(series) == 51, len(series)\n", encoding="utf-8")
    run = subprocess.run(
        [sys.executable, str(script)], cwd=tmp_path, env={"PYTHONPATH": str(ROOT), "PATH": ""}, capture_output=True
    )
    assert run.returncode == 0, run.stderr.decode()
    assert (tmp_path / "outputs" / "cube" / "comparison.nc").is_file()


@pytest.mark.slow
def test_the_example_has_the_right_types(tmp_path):
    script = tmp_path / "example.py"
    script.write_text(python_example(), encoding="utf-8")
    options = ["--config-file=", "--check-untyped-defs", "--follow-imports=silent", "--ignore-missing-imports"]
    command = [sys.executable, "-m", "mypy", *options, str(script)]
    run = subprocess.run(
        command, cwd=tmp_path, env=os.environ | {"MYPYPATH": str(ROOT)}, capture_output=True, text=True
    )
    assert run.returncode == 0, run.stdout
