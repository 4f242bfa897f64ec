"""A case: one scene and its variants, read from a TOML file and validated."""

import os
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

import tomli_w
from pydantic import ValidationError

from pipeline.case.document import read_document
from pipeline.case.keys import ONLY_VARIANT, CaseFile, MovieSpec
from pipeline.case.messages import describe_first_fault, name_faulty_key
from pipeline.case.overrides import apply_override, list_dropped_keys
from pipeline.case.python_values import PythonValue
from pipeline.case.spec import Spec
from pipeline.case.values import join_key
from pipeline.errors import CaseError, join_names, quote_value


class Case(CaseFile):
    """A case file and its path; for a single variant, also its name, the dotted keys that it sets, and notes."""

    path: Path
    variant_name: str | None = None
    own_keys: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def derived_keys(self) -> frozenset[str]:
        names = {"path", "variant_name", "own_keys", "notes"}
        return frozenset(names if self.variants else names | {"variants"})

    def __repr__(self) -> str:
        schedule = self.schedule
        variants = self.variant_name or f"{len(self.variant_names)} variants"
        return f"<Case {self.name}: {variants}, dt = {schedule.dt:g} s, {schedule.frames} frames, from {self.path}>"

    def _repr_html_(self) -> str:
        return f"<b>Case {escape(self.name)}</b><pre>{escape(self.to_toml())}</pre>"

    @property
    def variant_names(self) -> tuple[str, ...]:
        """Return the variants in the order of the file; a case without variants has one, "default"."""
        return tuple(self.variants) or (self.variant_name or ONLY_VARIANT,)

    @property
    def mesh_path(self) -> Path | None:
        """Return the path of the mesh file, relative to the folder of the case file; None for a shape."""
        return None if self.mesh.file is None else self.path.parent / self.mesh.file

    def variant(self, name: str) -> "Case":
        """Return the case with one variant's overrides applied; raises CaseError for an unknown name."""
        if name not in self.variant_names:
            raise CaseError(
                f"{self.path}: no variant {quote_value(name)}; choose from {join_names(self.variant_names)}"
            )
        document = self._document(written=True)
        document.pop("variants", None)
        document.get("movie", {}).pop("variants", None)
        own = self.variants.get(name, {})
        notes = list(self.notes)
        for key, value in own.items():
            lost = list_dropped_keys(document, key, value)
            if lost:
                place = join_key(("variants", name, key))
                notes.append(f"{place} replaces the whole table: {', '.join(lost)} reset to the default")
            try:
                document = apply_override(document, key, value)
            except ValueError as error:
                raise CaseError(f"{self.path}: {join_key(('variants', name, key))}: {error}") from None
        # a resolved case keeps its keys if the same variant is requested again
        keys = tuple(own) or self.own_keys
        return _validate(document, self.path, variant=name, keys=keys, notes=tuple(notes))

    def as_dict(self) -> dict[str, Any]:
        """Return the case as plain TOML values with defaults filled in; mesh.file stays relative to the case file."""
        return self._document(written=False)

    def to_toml(self, folder: str | os.PathLike[str] | None = None) -> str:
        """Return the case as TOML; if it will be saved in another `folder`, mesh.file becomes relative to it."""
        document = self.as_dict()
        if folder is not None and self.mesh_path is not None and not os.path.isabs(self.mesh.file or ""):
            # ".." leads to the parent of the real folder, not to that of a link to it
            document["mesh"]["file"] = Path(
                os.path.relpath(os.path.realpath(self.mesh_path), os.path.realpath(folder))
            ).as_posix()
        return tomli_w.dumps(document)

    def make_error(self, key: str, message: str) -> CaseError:
        """Return the error to raise about a dotted key; it names the variant's override if that set the key."""
        parts = tuple(key.split("."))
        if self.variant_name is None:
            return CaseError(f"{self.path}: {join_key(parts)}: {message}")
        return CaseError(f"{self.path}: {name_faulty_key(parts, self.variant_name, self.own_keys)}: {message}")

    def _document(self, *, written: bool) -> dict[str, Any]:
        document: dict[str, Any] = _to_toml_values(self, written)
        if self.movie.variants == self.variant_names:
            document.get("movie", {}).pop("variants", None)
        return document


def load_case(
    path: str | os.PathLike[str],
    *,
    overrides: Mapping[str, object] | None = None,
    steps: int | None = None,
) -> Case:
    """Return the case in a TOML file, with overrides applied and every variant checked.

    `steps` shortens the schedule of every variant to that many steps. Raises CaseError.
    """
    place = Path(path)
    try:
        document = read_document(place)
        for key, value in (overrides or {}).items():
            try:
                document = apply_override(document, key, value)
            except ValueError as error:
                raise CaseError(f"{place}: {join_key(tuple(key.split('.')))}: {error}") from None
        case = _validate(document, place, keys=tuple(overrides or ()))
        resolved = [case.variant(name) for name in case.variant_names]
        return case if steps is None else _cut_schedules(case, resolved, steps)
    except RecursionError:
        raise CaseError(f"{place}: nested too deeply") from None


def validate_case(document: Mapping[str, Any], path: Path) -> Case:
    """Return the case of a document that was made in Python, with every variant checked; raises CaseError."""
    case = _validate(dict(document), path)
    for name in case.variant_names:
        case.variant(name)
    return case


def _validate(
    document: dict[str, Any],
    path: Path,
    *,
    variant: str | None = None,
    keys: tuple[str, ...] = (),
    notes: tuple[str, ...] = (),
) -> Case:
    """Return the case of a document; `keys` are the overrides in it, or those of the variant if one is named."""
    try:
        file = CaseFile.model_validate(document)
    except ValidationError as error:
        parts, message = describe_first_fault(error, keys)
        if variant is None:
            place = join_key(parts)
        else:
            place = name_faulty_key(parts, variant, keys)
            if place == join_key(parts):
                place = f"{join_key(('variants', variant))}: {place}"
        raise CaseError(f"{path}: {place}: {message}") from None
    sections = {name: getattr(file, name) for name in file.model_fields_set}
    own = keys if variant is not None else ()
    case = Case(**sections, path=path, variant_name=variant, own_keys=own, notes=notes)
    return case if case.movie.variants else _show_all_variants(case)


def _show_all_variants(case: Case) -> Case:
    movie: MovieSpec = case.movie.model_copy(update={"variants": case.variant_names})
    return case.model_copy(update={"movie": movie})


def _cut_schedules(case: Case, resolved: list[Case], steps: int) -> Case:
    """Return the case in which no variant takes more than `steps` steps."""
    variants = {name: dict(own) for name, own in case.variants.items()}
    for variant in resolved:
        frames = _count_frames(variant, steps)
        own = variants.get(variant.variant_name or "", {})
        if any(key.split(".")[0] == "schedule" for key in own):
            own.pop("schedule.frames", None)  # so that it is set last, after an override of the whole table
            own["schedule.frames"] = frames
    schedule = case.schedule.model_copy(update={"frames": _count_frames(case, steps)})
    return case.model_copy(update={"schedule": schedule, "variants": variants})


def _count_frames(case: Case, steps: int) -> int:
    schedule = case.schedule
    if steps < schedule.steps_per_frame:
        key = "steps_per_frame" if schedule.frame_interval is None else "frame_interval"
        message = f"a frame takes {schedule.steps_per_frame} steps, more than the {steps} requested"
        raise case.make_error(f"schedule.{key}", message)
    return min(schedule.frames, steps // schedule.steps_per_frame)


def _to_toml_values(value: Any, written: bool) -> Any:
    """Return the TOML values of a section; `written` leaves out the defaults that the file does not set."""
    if isinstance(value, Spec):
        names = [name for name in type(value).model_fields if name not in value.derived_keys()]
        shown = [name for name in names if not written or name in value.model_fields_set]
        items = ((name, getattr(value, name)) for name in shown)
        return {name: _to_toml_values(item, written) for name, item in items if item is not None}
    if isinstance(value, PythonValue):
        return value if written else value.description
    if isinstance(value, Mapping):
        return {str(key): _to_toml_values(item, written) for key, item in value.items()}
    return [_to_toml_values(item, written) for item in value] if isinstance(value, list | tuple) else value
