"""A report as blocks, rendered as Markdown (pictures linked) and as one HTML file (pictures embedded)."""

import base64
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from pipeline.errors import OutputError


@dataclass(frozen=True)
class Heading:
    """A section's title; level 1 is the page's own."""

    text: str
    level: int = 2


@dataclass(frozen=True)
class Paragraph:
    """Text; `code` and **strong** are its only markup."""

    text: str


@dataclass(frozen=True)
class TableBlock:
    """Rows of text under a heading row."""

    head: tuple[str, ...]
    rows: Sequence[Sequence[str]]
    caption: str = ""


@dataclass(frozen=True)
class Picture:
    """A PNG with a caption."""

    path: Path
    caption: str


@dataclass(frozen=True)
class CodeListing:
    """Preformatted text, such as a file or commands."""

    text: str


Block = Heading | Paragraph | TableBlock | Picture | CodeListing
STYLE = """
:root { color-scheme: light dark; --ink: #1b1e28; --soft: #5a6070; --rule: #d9dce3; --page: #fff; --band: #f5f6f9;
  --good: #0b6b3a; --factor: #8a5a00; --bad: #a4262c; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e8ee; --soft: #a0a7b8; --rule: #363b48; --page: #14161c;
  --band: #1c1f28; --good: #5fd39a; --factor: #e8b65a; --bad: #ff8a8a; } }
body { margin: 0 auto; padding: 2rem 1.25rem 4rem; max-width: 72rem; background: var(--page); color: var(--ink);
  font: 1rem/1.6 system-ui, "Segoe UI", "DejaVu Sans", sans-serif; }
h1 { font-size: 1.9rem; line-height: 1.25; } h2 { margin-top: 3rem; border-bottom: 1px solid var(--rule); }
h3 { margin-top: 2rem; } p { max-width: 46rem; } a { color: inherit; }
nav { columns: 2; color: var(--soft); } nav a { display: block; }
.wide { overflow-x: auto; } table { border-collapse: collapse; margin: 1rem 0; font-size: .88rem; line-height: 1.45; }
caption { text-align: left; color: var(--soft); padding-bottom: .4rem; }
th, td { text-align: left; vertical-align: top; padding: .35rem .8rem .35rem 0; border-bottom: 1px solid var(--rule); }
th { border-bottom-width: 2px; } tbody tr:nth-child(even) { background: var(--band); }
td.number { font-variant-numeric: tabular-nums; white-space: nowrap; }
.good { color: var(--good); } .factor { color: var(--factor); } .bad { color: var(--bad); }
figure { margin: 1.5rem 0; }
img { max-width: 100%; background: #fff; border: 1px solid var(--rule); border-radius: 4px; }
figcaption { color: var(--soft); font-size: .9rem; max-width: 46rem; }
code { font-size: .9em; }
pre { overflow-x: auto; padding: .8rem 1rem; background: var(--band); border: 1px solid var(--rule);
  border-radius: 4px; line-height: 1.45; }
"""


def render_markdown(blocks: Sequence[Block], folder: Path) -> str:
    """Return the report as Markdown, pictures linked relative to a folder."""
    return "\n\n".join(_render_markdown_block(block, folder) for block in blocks) + "\n"


def _render_markdown_block(block: Block, folder: Path) -> str:
    if isinstance(block, Heading):
        return f"{'#' * block.level} {block.text}"
    if isinstance(block, Paragraph):
        return block.text
    if isinstance(block, Picture):
        place = Path(os.path.relpath(block.path, folder)).as_posix()
        return f"![{block.caption}]({place})\n\n*{block.caption}*"
    if isinstance(block, CodeListing):
        return f"```\n{block.text.rstrip()}\n```"
    rows = [block.head, ("---",) * len(block.head), *block.rows]
    lines = ["| " + " | ".join(cell.replace("|", r"\|") for cell in row) + " |" for row in rows]
    return "\n".join([f"*{block.caption}*", "", *lines] if block.caption else lines)


def render_html(blocks: Sequence[Block]) -> str:
    """Return the report as one HTML page that loads nothing; raises OutputError if a picture cannot be read."""
    title = next(block.text for block in blocks if isinstance(block, Heading))
    first, *others = (render_block(block) for block in blocks)
    sections = [b.text for b in blocks if isinstance(b, Heading) and b.level == 2]
    return render_document(title, "\n".join([first, render_navigation(sections), *others]))


def render_document(title: str, body: str, *, head: str = "") -> str:
    """Return a whole HTML page in the common style; `body` and `head` are HTML."""
    return (
        f'<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n<title>{escape(title)}</title>\n'
        f"<style>{STYLE}</style>\n{head}</head>\n<body>\n{body}\n</body>\n</html>\n"
    )


def render_navigation(sections: Sequence[str]) -> str:
    """Return HTML links to sections."""
    links = "".join(f'<a href="#{make_anchor(text)}">{escape(text)}</a>' for text in sections)
    return f'<nav aria-label="Contents">{links}</nav>'


def render_block(block: Block) -> str:
    """Return the HTML of a block; raises OutputError if a picture cannot be read."""
    if isinstance(block, Heading):
        return f'<h{block.level} id="{make_anchor(block.text)}">{escape(block.text)}</h{block.level}>'
    if isinstance(block, Paragraph):
        return f"<p>{_render_inline(block.text)}</p>"
    if isinstance(block, CodeListing):
        return f'<pre tabindex="0"><code>{escape(block.text.rstrip(), quote=False)}</code></pre>'
    if isinstance(block, Picture):
        return (
            f'<figure><img alt="{escape(block.caption)}" src="{read_data_uri(block.path, "image/png")}">'
            f"<figcaption>{_render_inline(block.caption)}</figcaption></figure>"
        )
    head = "".join(f'<th scope="col">{_render_inline(cell)}</th>' for cell in block.head)
    rows = "\n".join("<tr>" + "".join(_render_cell(cell) for cell in row) + "</tr>" for row in block.rows)
    caption = f"<caption>{_render_inline(block.caption)}</caption>" if block.caption else ""
    table = f"<table>{caption}<thead><tr>{head}</tr></thead>\n<tbody>\n{rows}\n</tbody></table>"
    return f'<div class="wide" tabindex="0">{table}</div>'  # focusable, so that keys can scroll a wide table


def _render_cell(text: str) -> str:
    kind = ""
    if text.startswith("not reproduced"):
        kind = "bad"
    elif text.startswith("reproduced"):
        kind = "factor" if "with factor" in text else "good"
    elif re.fullmatch(r"[-+−]?[\d.]+(e[-+]?\d+)?( %)?", text):
        kind = "number"
    return f'<td class="{kind}">{_render_inline(text)}</td>' if kind else f"<td>{_render_inline(text)}</td>"


def _render_inline(text: str) -> str:
    """Return the HTML of text with `code` and **strong**."""
    safe = escape(text, quote=False)
    safe = re.sub(r"`([^`]+)`", r"<code>\1</code>", safe)
    return re.sub(r"\*\*([^*]+)\*\*", r"<strong>\1</strong>", safe)


def make_anchor(text: str) -> str:
    """Return the id of the section with that title."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")


def read_data_uri(path: Path, kind: str) -> str:
    """Return a file as a data: URI; raises OutputError if it cannot be read."""
    try:
        return f"data:{kind};base64," + base64.b64encode(path.read_bytes()).decode("ascii")
    except OSError as error:
        raise OutputError(f"{path}: cannot be read ({error.strerror})") from error
