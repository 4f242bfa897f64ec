"""Golden scalars of every variant of every case, over its first frames: they guard against unintended change.

They are this program's own and prove nothing: other tests compare with closed forms, laws and published numbers.
    python -m tests.cases.test_golden --write [CASE ...]
writes them again, for all cases or those named; look at the diff.
"""

import argparse
import platform
import tomllib
from pathlib import Path

import numpy as np
import pytest
import scipy
import tomli_w

from pipeline import build, frames, load_case
from pipeline.run.measures import measure

ROOT = Path(__file__).resolve().parents[2]
CASES = {path.stem: path for path in sorted((ROOT / "cases").glob("*.toml"))}
FILE = ROOT / "tests" / "golden" / "scalars.toml"
COMMAND = "python -m tests.cases.test_golden --write"
FRAMES = 10  # all cases together take a quarter of a minute
# SuperLU in place of the banded solver changes these by 4e-12, conjugate gradients at their linear_rtol by 2e-8.
# One solve a step and converged steps differ by 1e-4 where they differ least, mostly by 1e-3 and more.
RTOL = 1e-6
VARIANTS = [(case, name) for case, path in CASES.items() for name in load_case(path).variant_names]


def compute_scalars(case: str, variant: str) -> dict[str, float]:
    """Return the numbers of a variant over its first frames.

    smallest and largest volume ratio of all cells and frames; at the last frame total_volume [m3] and kinetic plus
    elastic energy [J], which cannot cancel as a total with the loads' potential does.
    """
    resolved = load_case(CASES[case])
    count = min(FRAMES, resolved.schedule.frames)
    problem = build(load_case(CASES[case], overrides={"schedule.frames": count}).variant(variant))
    smallest = largest = 1.0
    for frame in frames(problem):
        ratio = measure(frame)["volume_ratio"]
        smallest, largest = min(smallest, float(ratio.min())), max(largest, float(ratio.max()))
    last = measure(frame)
    return {
        "smallest_volume_ratio": smallest,
        "largest_volume_ratio": largest,
        "total_volume": float(last["total_volume"]),
        "energy": float(last["kinetic_energy"] + last["elastic_energy"]),
    }


def read_golden() -> dict[str, dict[str, dict[str, float]]]:
    return tomllib.loads(FILE.read_text(encoding="utf-8"))["case"] if FILE.exists() else {}


@pytest.mark.parametrize(("case", "variant"), VARIANTS)
def test_a_variant_has_its_golden_scalars(case, variant):
    expected = read_golden().get(case, {}).get(variant)
    if expected is None:
        pytest.fail(f"{case}/{variant} has no golden scalars; make them with: {COMMAND} {case}", pytrace=False)
    assert compute_scalars(case, variant) == pytest.approx(expected, rel=RTOL), f"if intended: {COMMAND} {case}"


def test_every_golden_scalar_belongs_to_a_variant():
    stored = {(case, variant) for case, variants in read_golden().items() for variant in variants}
    assert stored - set(VARIANTS) == set(), f"write them again with: {COMMAND}"


def write_golden(cases: list[str]) -> None:
    """Write the scalars of these cases; those of other cases that still exist stay."""
    table = {case: values for case, values in read_golden().items() if case in CASES and case not in cases}
    for case, variant in VARIANTS:
        if case in cases:
            table.setdefault(case, {})[variant] = compute_scalars(case, variant)
            print(case, variant, table[case][variant])
    origin = {
        "command": COMMAND,
        "frames": FRAMES,
        "rtol": RTOL,
        "versions": f"Python {platform.python_version()}, numpy {np.__version__}, scipy {scipy.__version__}",
    }
    FILE.write_text(tomli_w.dumps({"origin": origin, "case": dict(sorted(table.items()))}), encoding="utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Golden scalars of the cases.")
    parser.add_argument("--write", nargs="*", metavar="CASE", choices=[*CASES, []], required=True)
    write_golden(parser.parse_args().write or list(CASES))
