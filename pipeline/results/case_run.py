"""From a case to its result folder: solves and records every variant, then compares and draws all."""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from pipeline.case import Case, load_case
from pipeline.errors import CaseError, SolveError
from pipeline.formats.atomic import write_whole
from pipeline.problem.problem import Problem, build, resolve_mass
from pipeline.results.comparison import MOVIE_FILES, compare_variants
from pipeline.results.disk import check_disk_space
from pipeline.results.interrupt import Interrupted, catch_interrupts
from pipeline.results.lock import lock_folder
from pipeline.results.resume import digest_body
from pipeline.results.variant_run import (
    UNFINISHED,
    OnVariantFrame,
    VariantResult,
    VariantRun,
    describe_difference,
    read_run,
    result_settings,
)
from pipeline.sinks.frame_formats import ensure_format
from pipeline.sinks.writer_process import WriterProcess
from pipeline.system.version import VERSION


@dataclass(frozen=True, repr=False)
class CaseResult:
    """The results of a run: its variants, the files that compare them, and notes for the user."""

    folder: Path
    variants: tuple[VariantResult, ...]
    files: tuple[Path, ...] = ()
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        variants = ", ".join(f"{variant.name} {variant.status}" for variant in self.variants)
        return f"<CaseResult in {self.folder}: {variants}>"

    @property
    def exit_code(self) -> int:
        """Return 3 if a variant failed, else 0."""
        return SolveError.exit_code if any(v.status == "failed" for v in self.variants) else 0


def run_case(
    case: Case | str | os.PathLike[str],
    out: str | os.PathLike[str] = "outputs",
    *,
    variants: Sequence[str] = (),
    force: bool = False,
    resume: bool = False,
    movie: bool = True,
    on_frame: OnVariantFrame | None = None,
    on_start: Callable[[str, Problem], None] | None = None,
    on_drawing: Callable[[int, int], None] | None = None,
) -> CaseResult:
    """Solve variants of a case (all by default) into out/<case name>/ and compare every finished one.

    `case` may be the path of a case file. A variant that is up to date is not solved again unless `force` is given;
    `resume` continues an unfinished one from its last checkpoint; `movie` draws comparison.mp4, which needs OpenGL.
    `on_start` is called with a variant before its matrices are factored and its kernels compiled, `on_frame` after each
    frame, `on_drawing` after each picture of the movie.

    Raises CaseError before anything is solved if a variant cannot be built, if the folder holds the result of another
    case or an unfinished one (without force or resume), or if another run is writing there; OutputError if files cannot
    be written; Interrupted after the step in which SIGINT or SIGTERM arrived. A variant that fails is part of the
    result.
    """
    case = case if isinstance(case, Case) else load_case(case)
    resolved = {name: resolve_mass(case.variant(name)) for name in variants or case.variant_names}
    folder = Path(out) / case.name
    problems = {name: build(variant) for name, variant in resolved.items()}
    for variant in resolved.values():
        ensure_format(variant.output.format)
    with lock_folder(folder) as lock, WriterProcess(keep=lock) as writer, catch_interrupts() as interrupt:
        todo = [
            name
            for name, variant in resolved.items()
            if _must_solve(variant, problems[name], folder / name, force=force, resume=resume)
        ]
        check_disk_space(folder, {name: (problems[name], resolved[name].output) for name in todo})
        redraw = _replace_case(case, folder)
        results = []
        for name, variant in resolved.items():
            if name in todo:
                if on_start is not None:
                    on_start(name, problems[name])
                variant_run = VariantRun(variant, problems[name], folder / name, interrupt, writer, on_frame)
                results.append(variant_run.solve(resume=resume and not force))
            else:
                results.append(VariantResult(name, folder / name, "up to date", read_run(folder / name)))
            if interrupt.requested:
                raise Interrupted(name)
        notes = [note for result in results for note in result.run.get("notes", ())]
        files, more = compare_variants(case, folder, movie=movie, on_drawing=on_drawing, rewrite=bool(todo) or redraw)
    return CaseResult(folder, tuple(results), tuple(files), tuple(dict.fromkeys([*notes, *more])))


def _replace_case(case: Case, folder: Path) -> bool:
    """Write case.toml; return whether the [movie] table, whose title all pictures show, has changed."""
    path = folder / "case.toml"
    try:
        redraw = load_case(path).movie != case.movie
    except CaseError:  # missing or unreadable
        redraw = True
    for name in MOVIE_FILES if redraw else ():  # before case.toml changes, so that no outdated movie is left
        (folder / name).unlink(missing_ok=True)
    write_whole(path, case.to_toml(folder))
    return redraw


def _must_solve(case: Case, problem: Problem, folder: Path, *, force: bool, resume: bool) -> bool:
    """Return whether a variant needs solving; raises CaseError if that would overwrite a result without permission."""
    run = {} if force else read_run(folder)
    if not run:
        return True
    changes = describe_difference(run.get("case", {}), result_settings(case))
    if changes:
        raise CaseError(f"{folder}: holds the result of another case ({changes}); --force replaces it, --out avoids it")
    if run["status"] not in UNFINISHED:
        return bool(run["status"] != "finished" or run["versions"]["pipeline"] != VERSION)
    if not resume:
        raise CaseError(f"{folder}: holds an unfinished run of this case; --resume continues it, --force starts again")
    changes = describe_difference(
        {"pipeline": run["versions"]["pipeline"], "mesh": run.get("mesh_digest")},
        {"pipeline": VERSION, "mesh": digest_body(problem.body)},
    )
    if changes:
        raise CaseError(f"{folder}: cannot continue with another version or mesh ({changes}); --force starts again")
    return True
