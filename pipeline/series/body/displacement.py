"""Which field is the displacement, and whether the points already contain it: decided by the numbers of many frames.

Solvers write deformed points, rest points with a displacement u, or deformed points and u as well. With x the points
and X the rest state,

    x_k - x_0 = 0          the points rest: u must be added to them
    x_k - x_0 = u_k - u_0  the points contain u: adding it would double it, and X = x_0 - u_0
    otherwise              the points move, and u is something else

A name decides only if the numbers allow it. If more than one reading is left, SeriesError asks for one.
"""

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Floats
from pipeline.errors import SeriesError, join_names, shorten
from pipeline.formats.grid import Grid
from pipeline.series.body.motion_evidence import MATCH, Evidence, FieldMotion, find_largest
from pipeline.series.body.vector_fields import VectorField, select_named_field

_NOISE = 1e-6  # of the size: text of six digits; no larger motion is taken for noise
_ABSURD = 100.0  # sizes of the body
_INVERTED = 0.5  # of the cells: methods that fail invert some, a velocity most
# formats whose points are those of the mesh, whatever the displacement
_MESH_FORMATS = {".e", ".ex2", ".exo", ".g", ".frd", ".med", ".rmed", ".mmed"}


@dataclass(frozen=True)
class DisplacementChoice:
    """The displacement field, if there is one, and whether it is `added` to the points or they contain it."""

    vector: VectorField | None
    added: bool
    notes: tuple[str, ...] = ()
    late: bool = False  # the first frame does not have it: it is zero there
    guessed: bool = False  # frames that were not looked at are checked when they are read
    text: str = ""  # for the two lines of an answer
    still: tuple[tuple[VectorField, Floats | None], ...] = ()  # fields that do not change, and their first values


def choose_displacement(
    evidence: Evidence, name: str | None, first: Grid, where: str, *, known_rest: bool
) -> DisplacementChoice:
    """Return the displacement that the evidence and the user's word `name` give; raises SeriesError to ask.

    `known_rest` says that the points were compared with a rest state that the user or the files give. If the files have
    it, in the field rest_position, points that move from it need no other evidence.
    """
    if name == "none":
        return DisplacementChoice(None, added=False, text="the points of the files, as displacement = none says")
    if name is not None:
        return _use_named(evidence, name, first, where)
    motions = {key: motion for key, motion in evidence.motions.items() if motion.vector.role != "derived"}
    if evidence.frames == 1 and not known_rest:
        return _judge_single_frame(evidence, motions, where)
    if known_rest and "rest_position" in first.point_data and not evidence.points_rest:
        return DisplacementChoice(None, added=False, text="deformed points")
    if contained := [m for m in motions.values() if _is_contained(evidence, m)]:
        return _note_contained(evidence, contained, where)
    if _do_points_rest(evidence, motions):
        return _choose_at_rest(evidence, motions, where)
    return _judge_moving_points(evidence, motions, where)


def _use_named(evidence: Evidence, name: str, first: Grid, where: str) -> DisplacementChoice:
    """Return the choice if the user named the field; the numbers still decide whether the points contain it."""
    motion = next((m for m in evidence.motions.values() if m.vector.name == name), None)
    vector = motion.vector if motion else select_named_field(first, name)
    if vector is None:
        raise SeriesError(_explain_missing(first, name, where))
    if motion is not None and _is_contained(evidence, motion):
        return _note_contained(evidence, [motion], where)
    late = not vector.is_in(first)
    return DisplacementChoice(
        vector, added=True, late=late, notes=_note_late(vector, late=late), text=f"rest points + {name}"
    )


def _explain_missing(first: Grid, name: str, where: str) -> str:
    names = join_names(sorted(first.point_data)) or "none"
    if name in first.point_data:
        return f"{where}: the point field {shorten(name)} {first.point_data[name].shape} is not a vector field"
    if name in first.cell_data:
        return (
            f"{where}: {shorten(name)} is a cell field, and cells do not say where their nodes are; write it at the "
            f'points, or displacement = "none"; the point fields are {names}'
        )
    return f"{where}: no point field {shorten(name)}; it has {names}"


def _is_contained(evidence: Evidence, motion: FieldMotion) -> bool:
    """Return whether the points move as the field says."""
    if motion.is_position or motion.varies <= evidence.rounding or evidence.moves <= evidence.rounding:
        return False
    allowed = max(2 * evidence.rounding, MATCH * min(motion.varies, evidence.size))  # a body may travel far
    return motion.differs <= allowed and evidence.moves >= motion.varies / 2


def _note_contained(evidence: Evidence, contained: list[FieldMotion], where: str) -> DisplacementChoice:
    best = min(contained, key=lambda m: (m.vector.role != "clear", m.differs))
    start = np.zeros(1) if best.first is None else best.first
    differ = [
        m.vector.name for m in contained
        if m.first is not None and m.vector.role == best.vector.role
        and find_largest(m.first - start) > max(2 * evidence.rounding, MATCH * m.varies)
    ]  # fmt: skip
    if differ:
        raise SeriesError(
            f"{where}: the points move as {join_names([best.vector.name, *differ])} do, which differ in the first "
            'frame, and so do the rest states: name the displacement (displacement = NAME), or say rest = "first"'
        )
    name, late = best.vector.name, best.first is None
    rest = "" if best.at_start <= evidence.rounding else "; the first frame is deformed already"
    note = (
        f"the points move as the field {shorten(name)} says, within {best.differs:.1g} m: it is not added to them{rest}"
    )
    return DisplacementChoice(
        best.vector, added=False, notes=(note,), late=late, text=f"deformed points, which contain {name}"
    )


def _do_points_rest(evidence: Evidence, motions: dict[str, FieldMotion]) -> bool:
    """Return whether the points move only by noise, which is small beside their size and beside a clear field."""
    if evidence.points_rest:
        return True
    clear = max((m.varies for m in motions.values() if m.vector.role == "clear"), default=0.0)
    return evidence.moves <= _NOISE * evidence.size and evidence.moves <= 1e-3 * clear


def _choose_at_rest(evidence: Evidence, motions: dict[str, FieldMotion], where: str) -> DisplacementChoice:
    """Return the one field that can be the displacement of points at rest; raises SeriesError if there are several."""
    motions = {key: m for key, m in motions.items() if not m.is_position or m.vector.role == "clear"}
    clear = _drop_copies([m for m in motions.values() if m.vector.role == "clear"])
    short = _drop_copies(
        [m for m in motions.values() if m.vector.role == "short" and m.largest > 0 and _varies(evidence, m)]
    )
    vague = [m for m in motions.values() if m.vector.role == "vague" and m.largest > 0 and _varies(evidence, m)]
    if len(clear) == 1 and (clear[0].largest > 0 or not short):
        return _take(evidence, clear[0])
    if len(clear) > 1 and len(moving := [m for m in clear if m.largest > 0]) == 1:
        return _take(evidence, moving[0])
    single = short[0] if len(short) == 1 and not vague and not clear else None
    if (
        single is not None
        and not evidence.flow
        and single.first is not None
        and single.at_start <= MATCH * single.varies
    ):
        return _take(evidence, single)
    if candidates := [*clear, *short, *vague]:
        raise SeriesError(_ask(evidence, candidates, where))
    if evidence.total == 1:
        return DisplacementChoice(None, added=False, text="the points of the only frame")
    if derived := [
        m for m in evidence.motions.values() if m.vector.role == "derived" and _varies(evidence, m) and m.largest > 0
    ]:
        raise SeriesError(_ask(evidence, derived, where))
    if evidence.unusable:
        raise SeriesError(
            f"{where}: the points do not move, and {join_names(evidence.unusable)} is no vector in the plane or space: "
            'name the fields of all components (displacement = "X,Y,Z"), or say displacement = "none"'
        )
    note = "the points do not move and there is no displacement field: the body is measured as at rest"
    if evidence.on_cells:
        note += f"; the cell field {shorten(evidence.on_cells[0])} does not say where its points are: write it at them"
    return DisplacementChoice(
        None, added=False, notes=(note,), guessed=evidence.frames < evidence.total,
        text="points at rest, no displacement", still=tuple((m.vector, m.first) for m in motions.values()),
    )  # fmt: skip


def _varies(evidence: Evidence, motion: FieldMotion) -> bool:
    """Return whether a field changes with time; a constant one (fibers, normals, a steady flow) moves nothing."""
    return evidence.total == 1 or motion.varies > 1e-9 * motion.largest or motion.frames < evidence.frames


def _take(evidence: Evidence, motion: FieldMotion) -> DisplacementChoice:
    vector, name = motion.vector, shorten(motion.vector.name)
    notes = [f"the points do not move; the field {name} is taken as the displacement"]
    if evidence.moves > 0:
        notes[0] = (
            f"the points move by {evidence.moves:.1g} m (rounding); the field {name} is taken as the displacement"
        )
    late = motion.first is None
    notes += _note_late(vector, late=late)
    if evidence.frames < evidence.total:
        notes.append(
            f"this was decided from {evidence.frames} of {evidence.total} frames; the others are checked when read"
        )
    return DisplacementChoice(
        vector,
        added=True,
        notes=tuple(notes),
        late=late,
        guessed=evidence.frames < evidence.total,
        text=f"rest points + {name}",
    )


def _note_late(vector: VectorField, *, late: bool) -> tuple[str, ...]:
    return (
        (f"the first frame does not have the field {shorten(vector.name)}: it is taken as zero there",) if late else ()
    )


def _drop_copies(motions: list[FieldMotion]) -> list[FieldMotion]:
    """Return the fields without those whose numbers are the same as those of an earlier one."""
    different = list[FieldMotion]()
    for motion in sorted(motions, key=lambda m: (len({source for source, _ in m.vector.columns}), len(m.vector.name))):
        same = [
            m for m in different
            if m.frames == motion.frames and np.isclose(m.largest, motion.largest, rtol=1e-6, atol=0)
            and np.isclose(m.varies, motion.varies, rtol=1e-6, atol=0)
            and (m.first is None) == (motion.first is None)
            and (m.first is None or motion.first is None or np.allclose(m.first, motion.first, atol=1e-6 * m.largest))
        ]  # fmt: skip
        if not same:
            different.append(motion)
    return different


def _ask(evidence: Evidence, candidates: list[FieldMotion], where: str) -> str:
    """Return the question, with the choices and the reasons against taking one of them."""
    names = join_names(sorted(m.vector.name for m in candidates))
    reasons = []
    if evidence.flow:
        reasons.append(f"beside {join_names(evidence.flow)}, a vector may be a velocity")
    if deformed := [m.vector.name for m in candidates if m.at_start > 0]:
        reasons.append(f"{join_names(deformed)} is not zero in the first frame")
    if late := [m.vector.name for m in candidates if m.first is None]:
        reasons.append(f"{join_names(late)} is not in the first frame")
    reason = f" ({'; '.join(reasons)})" if reasons else ""
    return (
        f"{where}: the points do not move, and the displacement may be any of {names}: say which "
        f'(displacement = NAME), or displacement = "none" if the body is at rest{reason}'
    )


def _judge_single_frame(evidence: Evidence, motions: dict[str, FieldMotion], where: str) -> DisplacementChoice:
    """Return the choice for a series of one frame: nothing moves in it, so only its format is evidence."""
    candidates = [m for m in motions.values() if m.largest > 0 and m.vector.role != "vague"]
    clear = _drop_copies([m for m in candidates if m.vector.role == "clear"])
    alone = evidence.total > 1
    if not candidates and not evidence.elsewhere:
        note = "no other frame that was looked at has the cells of the first one, so that nothing shows how points move"
        text = "the points of the first frame, whose cells no other has" if alone else "the points of the only frame"
        return DisplacementChoice(None, added=False, notes=(note,) if alone else (), text=text)
    if len(clear) == 1 and any(where.lower().endswith(suffix) for suffix in _MESH_FORMATS):
        return _take(evidence, clear[0])
    names = sorted({*evidence.elsewhere, *(m.vector.name for m in candidates)})
    raise SeriesError(
        f"{where}: one frame {'(no other has its cells) ' if alone else ''}does not tell whether its points rest "
        f"or contain the displacement ({join_names(names)}): say "
        f'displacement = "{names[0]}" if it must be added to them, displacement = "none" if they are '
        "deformed, or name the file of the rest state (rest = FILE)"
    )


def _judge_moving_points(evidence: Evidence, motions: dict[str, FieldMotion], where: str) -> DisplacementChoice:
    """Return the choice if the points move and no field is their motion; raises SeriesError if that is doubtful."""
    tiny = evidence.moves <= _NOISE * evidence.size
    for motion in motions.values():
        name, role = shorten(motion.vector.name), motion.vector.role
        if role == "clear" and motion.varies > evidence.rounding:
            _check_clear_field(evidence, motion, where)
        elif role == "short" and tiny and evidence.moves <= 1e-3 * motion.varies:
            raise SeriesError(
                f"{where}: the points move by {evidence.moves:.1g} m only, and {name} is up to {motion.varies:.3g}: "
                f'say displacement = "{name}" if it must be added to the points, or "none" if the points are deformed'
            )
    return DisplacementChoice(None, added=False, text="deformed points")


def _check_clear_field(evidence: Evidence, motion: FieldMotion, where: str) -> None:
    """Raise SeriesError if a displacement is not the motion of the points, nor its increment since the last frame."""
    name = shorten(motion.vector.name)
    if motion.differs_from_steps <= max(2 * evidence.rounding, MATCH * evidence.moves):
        return  # the increment of each step
    choices = (
        f'displacement = "none" if the points are deformed, or displacement = "{name}" if it must be added to them'
    )
    scales = motion.scales
    if len(scales) == motion.frames - 1 and scales and np.ptp(scales) <= MATCH * abs(np.mean(scales)):
        raise SeriesError(
            f"{where}: the points move by {np.mean(scales):.4g} times the field {name}: they are warped for a picture, "
            f"and their cells are not those of the body; {choices}"
        )
    raise SeriesError(
        f"{where}: the points move, but not as the field {name} says (up to {motion.differs:.3g} m apart): {choices}"
    )


def find_absurdity(size: float, u: Floats, inverted: float) -> str:
    """Return the fault of a displaced body that is huge or mostly inverted; empty if it is neither."""
    spread = float(np.ptp(u, axis=0).max(initial=0.0))
    if spread > _ABSURD * size:
        return f"stretches the body to {spread / size:.3g} times its size"
    return f"inverts {100 * inverted:.0f} % of the cells" if inverted > _INVERTED else ""
