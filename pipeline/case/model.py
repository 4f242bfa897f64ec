"""A case: what a TOML file says about one scene, validated, with its variants."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomli_w
from pydantic import ValidationError

from pipeline.case.document import read_document
from pipeline.case.messages import blamed, first_fault
from pipeline.case.overrides import forgotten, overridden
from pipeline.case.specs import ONLY_VARIANT, CaseFile, MovieSpec, Spec
from pipeline.case.values import dotted
from pipeline.errors import CaseError, join_names, quote_value


class Case(CaseFile):
    """A case file with its path as given; for one variant also its name, own dotted keys and notes."""

    path: Path
    variant_name: str | None = None
    own_keys: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def implied(self) -> frozenset[str]:
        names = {"path", "variant_name", "own_keys", "notes"}
        return frozenset(names if self.variants else names | {"variants"})

    @property
    def variant_names(self) -> tuple[str, ...]:
        """The variants in the file's order; a case without any has one, "default"."""
        return tuple(self.variants) or (self.variant_name or ONLY_VARIANT,)

    @property
    def mesh_path(self) -> Path | None:
        """The mesh file, found from the case file's folder; None for a shape."""
        return None if self.mesh.file is None else self.path.parent / self.mesh.file

    def variant(self, name: str) -> "Case":
        """The case with one variant's overrides applied and no variants. CaseError for an unknown name."""
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
            lost = forgotten(document, key, value)
            if lost:
                place = dotted(("variants", name, key))
                notes.append(f"{place} replaces the whole table: {', '.join(lost)} as if not written")
            try:
                document = overridden(document, key, value)
            except ValueError as error:
                raise CaseError(f"{self.path}: {dotted(('variants', name, key))}: {error}") from None
        # A resolved case keeps its keys when it is asked for itself again.
        keys = tuple(own) or self.own_keys
        return _validated(document, self.path, variant=name, keys=keys, notes=tuple(notes))

    def as_dict(self) -> dict[str, Any]:
        """The case as plain TOML values, defaults filled in; mesh.file stays relative to the case file."""
        return self._document(written=False)

    def to_toml(self, folder: str | os.PathLike[str] | None = None) -> str:
        """The case as TOML, to be saved in `folder` if one is given: mesh.file is then relative to it."""
        document = self.as_dict()
        if folder is not None and self.mesh_path is not None and not os.path.isabs(self.mesh.file or ""):
            # ".." climbs real folders, not links to them.
            document["mesh"]["file"] = Path(
                os.path.relpath(os.path.realpath(self.mesh_path), os.path.realpath(folder))
            ).as_posix()
        return tomli_w.dumps(document)

    def error(self, key: str, message: str) -> CaseError:
        """The error to raise about a dotted key; it names the variant's override where that set the key."""
        parts = tuple(key.split("."))
        if self.variant_name is None:
            return CaseError(f"{self.path}: {dotted(parts)}: {message}")
        return CaseError(f"{self.path}: {blamed(parts, self.variant_name, self.own_keys)}: {message}")

    def _document(self, *, written: bool) -> dict[str, Any]:
        document: dict[str, Any] = _plain(self, written)
        if self.movie.variants == self.variant_names:
            document.get("movie", {}).pop("variants", None)
        return document


def load_case(
    path: str | os.PathLike[str],
    *,
    overrides: Mapping[str, object] | None = None,
    steps: int | None = None,
) -> Case:
    """The case in a TOML file, overrides applied, every variant checked, cut to `steps` steps at most."""
    place = Path(path)
    try:
        document = read_document(place)
        for key, value in (overrides or {}).items():
            try:
                document = overridden(document, key, value)
            except ValueError as error:
                raise CaseError(f"{place}: {dotted(tuple(key.split('.')))}: {error}") from None
        case = _validated(document, place, keys=tuple(overrides or ()))
        resolved = [case.variant(name) for name in case.variant_names]
        return case if steps is None else _cut(case, resolved, steps)
    except RecursionError:
        raise CaseError(f"{place}: nested too deeply") from None


def _validated(
    document: dict[str, Any],
    path: Path,
    *,
    variant: str | None = None,
    keys: tuple[str, ...] = (),
    notes: tuple[str, ...] = (),
) -> Case:
    """The case of a document; `keys` are the overrides in it, those of the variant if one is named."""
    try:
        file = CaseFile.model_validate(document)
    except ValidationError as error:
        parts, message = first_fault(error, keys)
        if variant is None:
            place = dotted(parts)
        else:
            place = blamed(parts, variant, keys)
            if place == dotted(parts):
                place = f"{dotted(('variants', variant))}: {place}"
        raise CaseError(f"{path}: {place}: {message}") from None
    given = {name: getattr(file, name) for name in file.model_fields_set}
    own = keys if variant is not None else ()
    case = Case(**given, path=path, variant_name=variant, own_keys=own, notes=notes)
    return case if case.movie.variants else _with_movie_of_all(case)


def _with_movie_of_all(case: Case) -> Case:
    movie: MovieSpec = case.movie.model_copy(update={"variants": case.variant_names})
    return case.model_copy(update={"movie": movie})


def _cut(case: Case, resolved: list[Case], steps: int) -> Case:
    """The case in which no variant takes more than `steps` steps, whatever schedule it has."""
    variants = {name: dict(own) for name, own in case.variants.items()}
    for variant in resolved:
        frames = _frames(variant, steps)
        own = variants.get(variant.variant_name or "", {})
        if any(key.split(".")[0] == "schedule" for key in own):
            own.pop("schedule.frames", None)  # set last, after an override of the whole table
            own["schedule.frames"] = frames
    schedule = case.schedule.model_copy(update={"frames": _frames(case, steps)})
    return case.model_copy(update={"schedule": schedule, "variants": variants})


def _frames(case: Case, steps: int) -> int:
    schedule = case.schedule
    if steps < schedule.steps_per_frame:
        key = "steps_per_frame" if schedule.frame_interval is None else "frame_interval"
        message = f"a frame takes {schedule.steps_per_frame} steps, more than the {steps} asked for"
        raise case.error(f"schedule.{key}", message)
    return min(schedule.frames, steps // schedule.steps_per_frame)


def _plain(value: Any, written: bool) -> Any:
    """TOML values of a section; `written` leaves out what the file left out."""
    if isinstance(value, Spec):
        names = [name for name in type(value).model_fields if name not in value.implied()]
        kept = [name for name in names if not written or name in value.model_fields_set]
        items = ((name, getattr(value, name)) for name in kept)
        return {name: _plain(item, written) for name, item in items if item is not None}
    if isinstance(value, Mapping):
        return {str(key): _plain(item, written) for key, item in value.items()}
    return [_plain(item, written) for item in value] if isinstance(value, list | tuple) else value
