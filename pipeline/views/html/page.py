"""A result as one HTML file that loads nothing, neither from other files nor from a network."""

import json
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.formats.atomic import write_whole
from pipeline.formats.netcdf import open_dataset
from pipeline.mesh.body_mesh import BodyMesh
from pipeline.mesh.cell_text import describe_cells
from pipeline.series import Series
from pipeline.views.html.blocks import (
    Block,
    Heading,
    Paragraph,
    TableBlock,
    make_anchor,
    read_data_uri,
    render_block,
    render_document,
    render_navigation,
)
from pipeline.views.html.curves import collect_curves, find_worst_frame
from pipeline.views.html.solids import OnFrameRead, Solids, pack_solids
from pipeline.views.html.worst import WorstCell, find_worst_cells
from pipeline.views.size_text import describe_size

MOST_MOVIE_BYTES = 4_000_000  # a larger film is linked, not embedded
WORST = 5  # cells of each series
VIEWER = "The bodies are drawn by k3d and three.js (MIT); their licenses are in the source of this page."
NO_VIEWER = "The 3D view is missing: k3d is not installed (`pip install k3d`)."
# nothing may be loaded: the browser refuses any request that the page might make by mistake
_POLICY = (
    "default-src 'none'; img-src data: blob:; media-src data: file:; style-src 'unsafe-inline'; "
    "script-src 'unsafe-inline' blob:; worker-src blob:; connect-src blob:; font-src data:"
)
_MOVIE, _MOTION, _WORST = "The movie", "Bodies and curves", "Worst cells"
Curves = Mapping[str, Any]


@dataclass(frozen=True)
class Side:
    """One series of a result: its frames, its statistics.nc, and facts about its run by name."""

    label: str
    series: Series
    statistics: Path
    facts: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class PageContent:
    """The parts of a page: a title, series side by side, notes, a movie with its poster, and closing blocks."""

    title: str
    sides: tuple[Side, ...]
    closing: Sequence[Block] = ()
    notes: Sequence[str] = ()
    movie: Path | None = None
    poster: Path | None = None

    @property
    def dimension(self) -> int:
        """Return the dimension of the bodies, 2 or 3."""
        return self.sides[0].series.mesh.dimension


def write_page(content: PageContent, path: Path, on_frame: OnFrameRead | None = None) -> Path:
    """Write the page and return its path; `on_frame(label, done, frames)` is called after each frame that is read.

    Raises SeriesError if a series or its statistics cannot be read, OutputError if the page cannot be written.
    """
    with ExitStack() as stack:
        statistics = [stack.enter_context(open_dataset(side.statistics)) for side in content.sides]
        pairs = list(zip(statistics, (side.series for side in content.sides), strict=True))
        worst = [find_worst_cells(dataset, series.mesh, WORST) for dataset, series in pairs]
        curves = [collect_curves(dataset) for dataset in statistics]
        moments = [min(find_worst_frame(dataset), len(series) - 1) for dataset, series in pairs]
    labels = [side.label for side in content.sides]
    solids = pack_solids([side.series for side in content.sides], labels, moments, on_frame)
    data = {
        "labels": labels,
        "curves": curves,
        "solids": solids.meta if solids else None,
        "energy": "J" if content.dimension == 3 else "J/m",
        "start": max((cells[0] for cells in worst), key=lambda cell: abs(cell.volume_ratio - 1)).time,
    }
    policy = f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">\n'
    head = f"{policy}<style>{_read_asset('page.css')}</style>\n"
    parts = _render_parts(content, path.parent, curves, worst, solids)
    body = f"<main>\n{chr(10).join(filter(None, parts))}\n</main>\n{_render_scripts(data, solids)}"
    write_whole(path, render_document(content.title, body, head=head))
    return path


def _read_asset(name: str) -> str:
    return files("pipeline.views.html").joinpath(name).read_text(encoding="utf-8")


def _render_parts(
    content: PageContent, folder: Path, curves: Sequence[Curves], worst: Sequence[Sequence[WorstCell]],
    solids: Solids | None,
) -> list[str]:  # fmt: skip
    """Return HTML of the sections in order; empty for those that the page lacks."""
    labels = [side.label for side in content.sides]
    sections = [_MOVIE] if content.movie else []
    sections += [_MOTION, _WORST, *(b.text for b in content.closing if isinstance(b, Heading) and b.level == 2)]
    notes = [*content.notes, *([*solids.notes, VIEWER] if solids else [NO_VIEWER])]
    return [
        render_block(Heading(content.title, 1)),
        _render_summary(content, curves, worst),
        render_navigation(sections),
        _render_movie(content, folder) if content.movie else "",
        _render_motion(solids, labels),
        render_block(Heading(_WORST)),
        _render_worst_table(labels, worst, content.sides[0].series.mesh),
        *(render_block(block) for block in content.closing),
        render_block(Heading("Notes")) + _render_list(notes),
    ]


def _render_summary(content: PageContent, curves: Sequence[Curves], worst: Sequence[Sequence[WorstCell]]) -> str:
    """Return HTML of the outcome in words and numbers."""
    meshes = [side.series.mesh for side in content.sides]
    frames = max(len(side.series) for side in content.sides)
    start, end = (f([side.series.times[i] for side in content.sides]) for f, i in ((min, 0), (max, -1)))
    subject = f"{len(meshes)} series" if len(meshes) > 1 else "One series"
    words = f"{subject} of {describe_cells(meshes)}, {frames} frames from {start:g} to {end:g} s."
    sentences = [_describe(side.label, c, w[0]) for side, c, w in zip(content.sides, curves, worst, strict=True)]
    keys = list(dict.fromkeys(key for side in content.sides for key in side.facts))
    total = ("lowest total volume", "highest total volume", "final total volume")
    rows = [
        (side.label, *_list_extremes(c), *(side.facts.get(key, "") for key in keys))
        for side, c in zip(content.sides, curves, strict=True)
    ]
    table = TableBlock(("series", "smallest V/V₀", "largest V/V₀", *total, *keys), rows)
    return render_block(Paragraph(words)) + _render_list(sentences) + render_block(table)


def _describe(label: str, curves: Curves, worst: WorstCell) -> str:
    verb = "grows" if worst.volume_ratio > 1 else "shrinks" if worst.volume_ratio > 0 else "inverts"
    total = np.array(curves["total"], dtype=np.float64) / 100
    return (
        f"{label}: cell {worst.cell} {verb} to {worst.volume_ratio:.4g} times its rest volume at "
        f"t = {worst.time:.4g} s; {describe_size(np.array(curves['times'], dtype=np.float64), total)}."
    )


def _list_extremes(curves: Curves) -> tuple[str, ...]:
    (low, high), total = curves["bands"][0], _keep_finite(curves["total"])
    percent = [f"{value:.4g} %" for value in (total.min(), total.max(), total[-1])]
    known = [t for t, value in zip(curves["times"], curves["total"], strict=True) if value is not None]
    if known and known[-1] != curves["times"][-1]:
        percent[-1] += f" at t = {known[-1]:.4g} s"
    return f"{_keep_finite(low).min():.4g}", f"{_keep_finite(high).max():.4g}", *percent


def _keep_finite(values: Sequence[float | None]) -> "np.ndarray":
    return np.array([value for value in values if value is not None] or [np.nan])


def _render_movie(content: PageContent, folder: Path) -> str:
    """Return HTML of the movie: embedded in the page, or linked if it is large."""
    assert content.movie is not None
    note = ""
    if content.movie.stat().st_size > MOST_MOVIE_BYTES:
        source = escape(content.movie.name) if content.movie.parent == folder else content.movie.absolute().as_uri()
        note = f"<p>The movie is too large to be embedded in this page: it is the file <code>{source}</code>.</p>"
    else:
        source = read_data_uri(content.movie, "video/mp4")
    poster = read_data_uri(content.poster, "image/png") if content.poster else ""
    alt = "All series side by side at the moment of the largest volume change"
    still = f'<img id="poster" class="paper" alt="{alt}" src="{poster}">' if poster else ""
    return (
        f'{render_block(Heading(_MOVIE))}\n{note}<figure class="film"><video id="movie" controls playsinline '
        f'preload="metadata" aria-label="Movie of all series side by side" src="{source}"></video>{still}</figure>'
    )


def _render_motion(solids: Solids | None, labels: Sequence[str]) -> str:
    """Return HTML of the time slider and of the places for bodies and curves."""
    boxes = "".join(
        f'<label><input type="checkbox" value="{i}"> {escape(label)}</label>' for i, label in enumerate(labels)
    )
    parts = {
        "[TITLE]": render_block(Heading(_MOTION)),
        "[ANCHOR]": make_anchor(_MOTION),
        "[SOLIDS]": "" if solids is None else _read_asset("solids.html").replace("[BOXES]", boxes),
    }
    text = _read_asset("motion.html")
    for mark, part in parts.items():
        text = text.replace(mark, part)
    return text


def _render_worst_table(labels: Sequence[str], worst: Sequence[Sequence[WorstCell]], mesh: BodyMesh) -> str:
    """Return HTML of the worst cells; a button in each row shows everything at that time."""
    curved = any(cell.extremes is not None for cells in worst for cell in cells)
    more = ("smallest det F in it", "largest") if curved else ()
    head = ("series", "cell", "V/V₀", *more, "time [s]", "cell center at rest [m]")
    columns = "".join(f'<th scope="col">{text}</th>' for text in head) + '<th scope="col" class="screen">go to</th>'
    rows = []
    for label, cell in ((label, cell) for label, cells in zip(labels, worst, strict=True) for cell in cells):
        place = ", ".join(f"{value:.4g}" for value in cell.place[: mesh.points.shape[1]])
        extremes = [f"{value:.5g}" for value in cell.extremes] if cell.extremes else ["", ""] if curved else []
        texts = (str(cell.cell), f"{cell.volume_ratio:.5g}", *extremes, f"{cell.time:.5g}", f"({place})")
        name = f"Show the time of cell {cell.cell} of {label}"
        rows.append(
            f'<tr><th scope="row">{escape(label)}</th>'
            + "".join(f'<td class="number">{text}</td>' for text in texts)
            + f'<td class="screen"><button type="button" data-time="{cell.time:.9g}" aria-label="{escape(name)}">'
            "Show</button></td></tr>"
        )
    caption = "Cells with the largest |V/V₀ − 1|, numbered from 0 as in the files."
    return (
        f'<div class="wide" tabindex="0"><table id="worst"><caption>{caption}</caption>'
        f"<thead><tr>{columns}</tr></thead>\n"
        f"<tbody>\n{chr(10).join(rows)}\n</tbody></table></div>"
    )


def _render_list(notes: Sequence[str]) -> str:
    return "<ul>" + "".join(f"<li>{escape(note, quote=False)}</li>" for note in dict.fromkeys(notes)) + "</ul>"


def _render_scripts(data: Mapping[str, Any], solids: Solids | None) -> str:
    """Return HTML of data and programs; `<` is escaped, so that no text of a case can end a script."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    parts = [f'<script type="application/json" id="data">{text}</script>']
    if solids is not None:
        parts.append(f'<script type="text/plain" id="viewer">{solids.program}</script>')
        parts.append(f'<script type="text/plain" id="licenses">{solids.licenses.replace("</", "")}</script>')
        parts += [f'<script type="text/plain" id="scene-{i}">{scene}</script>' for i, scene in enumerate(solids.scenes)]
    names = ["clock.js", "curves.js", *(["solids.js"] if solids else [])]
    return "\n".join([*parts, *(f"<script>{_read_asset(name)}</script>" for name in names)])
