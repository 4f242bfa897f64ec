"""The site builds without a warning: every link, docstring, key and case page."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
def test_the_site_builds_without_a_warning(tmp_path):
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-b", "html", "docs", str(tmp_path)]
    build = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert build.returncode == 0, build.stderr
    case_files = (tmp_path / "case_files.html").read_text(encoding="utf-8")
    assert "youngs_modulus" in case_files and "symplectic_euler" in case_files
    assert "heavy_beam" in (tmp_path / "_generated" / "gallery.html").read_text(encoding="utf-8")
    assert "pipeline.read_series" in (tmp_path / "api.html").read_text(encoding="utf-8")
