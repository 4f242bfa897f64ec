"""The site: `make docs` builds it into docs/_build/html from these pages, the docstrings, the schema and cases/."""

import re
import sys
from pathlib import Path

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
sys.path.insert(0, str(ROOT))

from pipeline import __version__  # noqa: E402

project = "Volume drift of deformable solids"
author = "The corotational-pipeline authors"
version = release = __version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.mathjax", "sphinx.ext.viewcode", "sphinx_copybutton"]
html_theme = "furo"
html_title = project
exclude_patterns = ["_build", "gallery", "**.ipynb_checkpoints"]  # the gallery's page is for the repository's reader
nb_execution_mode = "off"  # tests/docs runs the notebook
myst_enable_extensions = ["dollarmath", "amsmath"]
myst_heading_anchors = 4
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_default_options = {"members": True, "show-inheritance": True, "exclude-members": "model_config"}
autodoc_preserve_defaults = True
copybutton_exclude = ".linenos, .gp"

ROOMS = "case formats mesh fem linear stepping problem run sinks series analysis views results studies system".split()
_MARKUP = re.compile(r"(`[^`]+`)|([*_|\\])")


def write_api_pages() -> None:
    """Write a page for every room, with all its modules, and one for what `import pipeline` offers."""
    folder = DOCS / "_generated" / "api"
    folder.mkdir(parents=True, exist_ok=True)
    for room in ROOMS:
        files = sorted((ROOT / "pipeline" / room).rglob("*.py"))
        modules = [".".join(file.relative_to(ROOT).with_suffix("").parts) for file in files]
        shown = [m for m in modules if not m.endswith(("__init__", "paraview_script")) and ".kernels." not in m]
        parts = [f"# pipeline.{room}\n", _document_module(f"pipeline.{room}", members=False)]
        parts += [f"## {module}\n\n{_document_module(module)}" for module in shown]
        (folder / f"{room}.md").write_text("\n".join(parts), encoding="utf-8")


def _document_module(module: str, *, members: bool = True) -> str:
    option = "" if members else "   :no-members:\n"
    return f"```{{eval-rst}}\n.. automodule:: {module}\n{option}```\n"


def write_gallery() -> None:
    """Write a page with every case: its picture, its description and its file."""
    parts = ["# Gallery\n", "Every scene in `cases/`, as `pipeline run cases/NAME.toml` draws it.\n"]
    for path in sorted((ROOT / "cases").glob("*.toml")):
        picture = DOCS / "gallery" / f"{path.stem}.png"
        image = f"![The movie's picture of {path.stem}](../gallery/{picture.name})\n" if picture.is_file() else ""
        parts.append(
            f"## {path.stem}\n\n{image}\n```{{literalinclude}} ../../cases/{path.name}\n:language: toml\n```\n"
        )
    (DOCS / "_generated" / "gallery.md").write_text("\n".join(parts), encoding="utf-8")


def escape_docstring(_app, _what, _name, _object, _options, lines: list[str]) -> None:
    """Turn a plain docstring into reStructuredText: code in backticks, indented blocks as they are, no other markup."""
    out: list[str] = []
    block = False
    for line in lines:
        if line.strip() and line.startswith(" ") != block:
            block = not block
            out += ["", "::", ""] if block else [""]
        out.append(line if block else _MARKUP.sub(lambda match: f"`{match[1]}`" if match[1] else f"\\{match[2]}", line))
    lines[:] = out


def setup(app) -> None:
    """Write the generated pages before the sources are read."""
    write_api_pages()
    write_gallery()
    app.connect("autodoc-process-docstring", escape_docstring)
