"""A case to its result folder: every variant solved and recorded, then compared and drawn."""

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
from pipeline.results.resume import digest_mesh
from pipeline.results.variant_run import (
    UNFINISHED,
    Notify,
    VariantResult,
    VariantRun,
    describe_difference,
    read_run,
    result_settings,
)
from pipeline.sinks.frame_formats import ensure_format
from pipeline.sinks.writer_process import WriterProcess
from pipeline.system.version import VERSION


@dataclass(frozen=True)
class CaseResult:
    """All variants asked for, the pictures and datasets made of them, and what there is to say."""

    folder: Path
    variants: tuple[VariantResult, ...]
    made: tuple[Path, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def exit_code(self) -> int:
        """Return 3 where a variant failed, else 0."""
        return SolveError.exit_code if any(v.status == "failed" for v in self.variants) else 0


def run_case(
    case: Case,
    out: Path,
    *,
    variants: Sequence[str] = (),
    force: bool = False,
    resume: bool = False,
    movie: bool = True,
    notify: Notify | None = None,
    on_start: Callable[[str, Problem], None] | None = None,
    on_drawing: Callable[[int, int], None] | None = None,
) -> CaseResult:
    """Solve the variants asked for (default: all) into out/<case name>/ and compare every finished one.

    `on_start` is told of a variant before its matrices are factored and, once a machine, its kernels compiled.
    `resume` goes on with an unfinished result where it stopped. Raises CaseError before anything is solved where a
    variant cannot be built, where a folder holds another case's result or an unfinished one and neither force nor
    resume is given, or where another run writes there; OutputError where files cannot be written; Interrupted after
    the step at which SIGINT or SIGTERM came.
    """
    resolved = {name: resolve_mass(case.variant(name)) for name in variants or case.variant_names}
    folder = Path(out) / case.name
    problems = {name: build(one) for name, one in resolved.items()}
    for one in resolved.values():
        ensure_format(one.output.format)
    with lock_folder(folder) as lock, WriterProcess(keep=lock) as writer, catch_interrupts() as asked:
        todo = [
            name
            for name, one in resolved.items()
            if _must_solve(one, problems[name], folder / name, force=force, resume=resume)
        ]
        check_disk_space(folder, {name: (problems[name], resolved[name].output) for name in todo})
        redraw = _is_movie_changed(case, folder)
        for name in MOVIE_FILES if redraw else ():  # before case.toml changes: an interruption leaves no old movie
            (folder / name).unlink(missing_ok=True)
        write_whole(folder / "case.toml", case.to_toml(folder))
        results = []
        for name, one in resolved.items():
            if name in todo:
                if on_start is not None:
                    on_start(name, problems[name])
                solving = VariantRun(one, problems[name], folder / name, asked, writer, notify)
                results.append(solving.solve(resume=resume and not force))
            else:
                results.append(VariantResult(name, folder / name, "up to date", read_run(folder / name)))
            if asked.requested:
                raise Interrupted(f"interrupted after {name}; the same command with --resume goes on from there")
        notes = [note for one in results for note in one.run.get("notes", ())]
        made, more = compare_variants(case, folder, movie=movie, on_drawing=on_drawing, fresh=bool(todo) or redraw)
    return CaseResult(folder, tuple(results), tuple(made), tuple(dict.fromkeys([*notes, *more])))


def _is_movie_changed(case: Case, folder: Path) -> bool:
    """Return whether the folder's pictures are of another [movie] table, whose title is on the plots too."""
    try:
        return load_case(folder / "case.toml").movie != case.movie
    except CaseError:  # there is none yet, or none that can be read
        return True


def _must_solve(case: Case, problem: Problem, folder: Path, *, force: bool, resume: bool) -> bool:
    """Return whether a variant is to be solved; raises CaseError where that would overwrite without leave."""
    run = {} if force else read_run(folder)
    if not run:
        return True
    changes = describe_difference(run.get("case", {}), result_settings(case))
    if changes:
        raise CaseError(f"{folder}: holds the result of another case ({changes}); --force replaces it, --out avoids it")
    if run["status"] not in UNFINISHED:
        return bool(run["status"] != "finished" or run["versions"]["pipeline"] != VERSION)
    if not resume:
        raise CaseError(
            f"{folder}: an unfinished run of this case; --resume goes on where it stopped, --force starts it again"
        )
    changes = describe_difference(
        {"pipeline": run["versions"]["pipeline"], "mesh": run.get("mesh_digest")},
        {"pipeline": VERSION, "mesh": digest_mesh(problem.body.mesh)},
    )
    if changes:
        raise CaseError(f"{folder}: cannot go on with another version or mesh ({changes}); --force starts it again")
    return True
