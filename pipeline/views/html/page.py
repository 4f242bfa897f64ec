"""The page itself: everything about a result in one HTML file that asks for nothing, not even a network."""

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

MOST_MOVIE_BYTES = 4_000_000  # a longer film is linked, not carried along
WORST = 5  # cells a series
VIEWER = "The bodies are drawn by k3d and three.js (MIT); their licenses are in the source of this page."
NO_VIEWER = "The bodies in space are missing: the package k3d is not installed (`pip install k3d`)."
# nothing may be fetched: a browser refuses what this page should ever ask for
_POLICY = (
    "default-src 'none'; img-src data: blob:; media-src data: file:; style-src 'unsafe-inline'; "
    "script-src 'unsafe-inline' blob:; worker-src blob:; connect-src blob:; font-src data:"
)
_MOVIE, _MOTION, _WORST = "The movie", "Bodies and curves", "The worst cells"


@dataclass(frozen=True)
class Side:
    """One series of a result: its frames, the statistics.nc measured of it, and facts of its run to be told."""

    label: str
    series: Series
    statistics: Path
    facts: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class PageContent:
    """What a page is made of: a title, series side by side, notes, a movie with its poster, and texts to close with."""

    title: str
    sides: tuple[Side, ...]
    closing: Sequence[Block] = ()
    notes: Sequence[str] = ()
    movie: Path | None = None
    poster: Path | None = None


def write_page(result: PageContent, path: Path, on_frame: OnFrameRead | None = None) -> Path:
    """Write the page and return its path; `on_frame(label, done, frames)` is called after each frame that is read.

    Raises SeriesError where a series or its statistics cannot be read, OutputError where the page cannot be written.
    """
    with ExitStack() as stack:
        statistics = [stack.enter_context(open_dataset(side.statistics)) for side in result.sides]
        worst = [find_worst_cells(s, side.series.mesh, WORST) for s, side in zip(statistics, result.sides, strict=True)]
        drawn = [collect_curves(one) for one in statistics]
        moments = [
            min(find_worst_frame(s), len(side.series) - 1) for s, side in zip(statistics, result.sides, strict=True)
        ]
    labels = [side.label for side in result.sides]
    shown = pack_solids([side.series for side in result.sides], labels, moments, on_frame)
    notes = [*result.notes, *([*shown.notes, VIEWER] if shown else [NO_VIEWER])]
    closing = [render_block(block) for block in result.closing]
    sections = [_MOVIE] if result.movie else []
    sections += [_MOTION, _WORST, *(b.text for b in result.closing if isinstance(b, Heading) and b.level == 2)]
    body = [
        render_block(Heading(result.title, 1)),
        _summary(result, drawn, worst),
        render_navigation(sections),
        _film(result, path.parent) if result.movie else "",
        _motion(shown, labels),
        render_block(Heading(_WORST)),
        _worst_table(labels, worst, result.sides[0].series.mesh.dimension),
        *closing,
        render_block(Heading("Notes")) + _list(notes) if notes else "",
    ]
    data = {
        "labels": labels,
        "curves": drawn,
        "solids": shown.meta if shown else None,
        "energy": "J" if result.sides[0].series.mesh.dimension == 3 else "J/m",
        "start": max(worst, key=lambda found: abs(found[0].volume_ratio - 1))[0].time,  # the most telling moment
    }
    policy = f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">\n<style>{_asset("page.css")}</style>\n'
    whole = f"<main>\n{chr(10).join(filter(None, body))}\n</main>\n{_scripts(data, shown)}"
    write_whole(path, render_document(result.title, whole, head=policy))
    return path


def _asset(name: str) -> str:
    return files("pipeline.views.html").joinpath(name).read_text(encoding="utf-8")


def _summary(result: PageContent, drawn: Sequence[Mapping[str, Any]], worst: Sequence[Sequence[WorstCell]]) -> str:
    """Return HTML of what came out, in words and numbers."""
    meshes = [side.series.mesh for side in result.sides]
    cells = {len(mesh.cells) for mesh in meshes}
    kind = {2: "triangles", 3: "tetrahedra"}[meshes[0].dimension]
    count = " and ".join(f"{n:,}".replace(",", " ") for n in sorted(cells))
    frames = max(len(side.series) for side in result.sides)
    start, end = (f([side.series.times[i] for side in result.sides]) for f, i in ((min, 0), (max, -1)))
    who = f"{len(meshes)} series" if len(meshes) > 1 else "One series"
    words = f"{who} of {count} {kind}, {frames} frames from {start:g} to {end:g} s."
    told = [_sentence(side.label, d, w[0]) for side, d, w in zip(result.sides, drawn, worst, strict=True)]
    keys = list(dict.fromkeys(key for side in result.sides for key in side.facts))
    head = ("series", "smallest V/V₀", "largest V/V₀", "total volume, lowest", "highest", "at the end", *keys)
    rows = [
        (side.label, *_extremes(d), *(side.facts.get(key, "") for key in keys))
        for side, d in zip(result.sides, drawn, strict=True)
    ]
    return render_block(Paragraph(words)) + _list(told) + render_block(TableBlock(head, rows))


def _sentence(label: str, drawn: Mapping[str, Any], worst: WorstCell) -> str:
    drift = _finite(drawn["total"])[-1] - 100
    verb = "grows" if worst.volume_ratio > 1 else "shrinks" if worst.volume_ratio > 0 else "is turned inside out"
    return (
        f"{label}: cell {worst.cell} {verb} to {worst.volume_ratio:.4g} times its rest volume at "
        f"t = {worst.time:.4g} s; in the end the whole body is {abs(drift):.2g} % "
        f"{'larger' if drift > 0 else 'smaller'} than at rest."
    )


def _extremes(drawn: Mapping[str, Any]) -> tuple[str, ...]:
    (low, high), total = drawn["bands"][0], _finite(drawn["total"])
    percent = [f"{value:.4g} %" for value in (total.min(), total.max(), total[-1])]
    return f"{_finite(low).min():.4g}", f"{_finite(high).max():.4g}", *percent


def _finite(values: Sequence[float | None]) -> "np.ndarray":
    return np.array([value for value in values if value is not None] or [np.nan])


def _film(result: PageContent, folder: Path) -> str:
    """Return HTML of the movie: inside the page, or beside it where it is long."""
    assert result.movie is not None
    note = ""
    if result.movie.stat().st_size > MOST_MOVIE_BYTES:
        source = escape(result.movie.name) if result.movie.parent == folder else result.movie.absolute().as_uri()
        note = f"<p>The movie is too long to be carried inside this page; it is the file <code>{source}</code>.</p>"
    else:
        source = read_data_uri(result.movie, "video/mp4")
    poster = read_data_uri(result.poster, "image/png") if result.poster else ""
    alt = "The moment of the largest change of volume, all series side by side"
    still = f'<img id="poster" class="paper" alt="{alt}" src="{poster}">' if poster else ""
    return (
        f'{render_block(Heading(_MOVIE))}\n{note}<figure class="film"><video id="movie" controls playsinline '
        f'preload="metadata" aria-label="Movie of all series side by side" src="{source}"></video>{still}</figure>'
    )


def _motion(shown: Solids | None, labels: Sequence[str]) -> str:
    """Return HTML of the time bar, of places for the bodies, and of places for the curves."""
    boxes = "".join(
        f'<label><input type="checkbox" value="{i}"> {escape(label)}</label>' for i, label in enumerate(labels)
    )
    parts = {
        "[TITLE]": render_block(Heading(_MOTION)),
        "[ANCHOR]": make_anchor(_MOTION),
        "[SOLIDS]": "" if shown is None else _asset("solids.html").replace("[BOXES]", boxes),
    }
    text = _asset("motion.html")
    for mark, part in parts.items():
        text = text.replace(mark, part)
    return text


def _worst_table(labels: Sequence[str], worst: Sequence[Sequence[WorstCell]], dimension: int) -> str:
    """Return HTML of the worst cells; a button a row moves everything to that time."""
    head = ("series", "cell", "V/V₀", "time [s]", "middle of the cell at rest [m]")
    cells = "".join(f'<th scope="col">{text}</th>' for text in head) + '<th scope="col" class="screen">look</th>'
    rows = []
    for label, found in zip(labels, worst, strict=True):
        for one in found:
            place = ", ".join(f"{value:.4g}" for value in one.place[:dimension])
            texts = (str(one.cell), f"{one.volume_ratio:.5g}", f"{one.time:.5g}", f"({place})")
            name = f"Show the time of cell {one.cell} of {label}"
            rows.append(
                f'<tr><th scope="row">{escape(label)}</th>'
                + "".join(f'<td class="number">{text}</td>' for text in texts)
                + f'<td class="screen"><button type="button" data-time="{one.time:.9g}" aria-label="{escape(name)}">'
                "Show</button></td></tr>"
            )
    caption = "Cells by their largest |V/V₀ − 1|; cells are counted from 0, as in the files."
    return (
        f'<div class="wide" tabindex="0"><table id="worst"><caption>{caption}</caption>'
        f"<thead><tr>{cells}</tr></thead>\n"
        f"<tbody>\n{chr(10).join(rows)}\n</tbody></table></div>"
    )


def _list(notes: Sequence[str]) -> str:
    return "<ul>" + "".join(f"<li>{escape(note, quote=False)}</li>" for note in dict.fromkeys(notes)) + "</ul>"


def _scripts(data: Mapping[str, Any], shown: Solids | None) -> str:
    """Return HTML of data and programs; `<` is written so that no text of a case can end a script."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    parts = [f'<script type="application/json" id="data">{text}</script>']
    if shown is not None:
        parts.append(f'<script type="text/plain" id="viewer">{shown.program}</script>')
        parts.append(f'<script type="text/plain" id="licenses">{shown.licenses.replace("</", "")}</script>')
        parts += [f'<script type="text/plain" id="scene-{i}">{s}</script>' for i, s in enumerate(shown.scenes)]
    names = ["clock.js", "curves.js", *(["solids.js"] if shown else [])]
    return "\n".join([*parts, *(f"<script>{_asset(name)}</script>" for name in names)])
