"""The cost of a step against the size of the mesh, beside plain scipy and the other programs that are installed.

    python -m benchmarks.scaling CASE… [--cells 2x8x2 8x26x8] [--method NAME] [--out outputs/bench]

It is `pipeline study scaling` with rivals: plain scipy takes turns with one_solve and order_two, and each
other program (peers.py) has a row of its own. Writes bench.json and scaling.png. Nothing else should run.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.peers import PEERS, list_installed, make_rival
from pipeline import load_case
from pipeline.cli.terminal import show_progress
from pipeline.errors import CaseError, PipelineError
from pipeline.studies.scaling.rival import Rival
from pipeline.studies.scaling.step_cost import METHODS
from pipeline.studies.scaling.study import Scaling, parse_cells, study_scaling

INSTALL = "pip install 'corotational-pipeline[bench]', in an environment of its own"
PLAIN_SCIPY = Rival(
    name="plain scipy",
    task="benchmarks.plain_scipy:list_starts",
    label="plain scipy",
    color="#7d8597",
    differs="plain scipy: the better of SuperLU and Jacobi-CG",
    beside=("one_solve", "order_two"),
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table and return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("cases", metavar="CASE", type=Path, nargs="+", help="case files")
    parser.add_argument("--cells", metavar="NXxNYxNZ", nargs="+", default=[], help="boxes to try, such as 2x8x2 8x26x8")
    parser.add_argument("--method", dest="names", metavar="NAME", action="append", choices=(*METHODS, *PEERS),
                        help="only this; may be repeated; by default all, and the other programs that are installed",
                        )  # fmt: skip
    parser.add_argument("--rtol", type=float, default=1e-6, help="relative residual of linear systems (%(default)g)")
    parser.add_argument("--no-baseline", action="store_true", help="without plain scipy, which takes most of the time")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    parser.add_argument("--out", type=Path, default=Path("outputs/bench"), help="folder of the results (%(default)s)")
    options = parser.parse_args(arguments)
    try:
        scaling = measure(options)
    except PipelineError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return error.exit_code
    print(*scaling.format_lines(), sep="\n")
    if missing := [name for name in PEERS if name not in list_installed()]:
        print(f"not compared with {', '.join(missing)}: {INSTALL}")
    print(f"bandwidth {scaling.bandwidth:.1f} GB/s", *(f"  {path}" for path in scaling.files), sep="\n")
    return 0


def measure(options: argparse.Namespace) -> Scaling:
    """Return the study that the options ask for; raises CaseError if a named program is not installed."""
    names = options.names or [*METHODS, *list_installed()]
    if missing := [name for name in names if name in PEERS and name not in list_installed()]:
        raise CaseError(f"--method {missing[0]}: is not installed: {INSTALL}")
    rivals = [] if options.no_baseline else [PLAIN_SCIPY]
    rivals += [make_rival(name) for name in names if name in PEERS]
    with show_progress(options.quiet) as bars:
        return study_scaling(
            [load_case(path) for path in options.cases],
            options.out,
            cells=[parse_cells(text) for text in options.cells],
            methods=[name for name in names if name in METHODS],
            rtol=options.rtol,
            rivals=rivals,
            on_point=lambda done, total: bars.show_reading("scaling", done, total),
        )


if __name__ == "__main__":
    sys.exit(main())
