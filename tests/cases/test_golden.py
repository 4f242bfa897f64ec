"""Golden scalars of every variant of every case, over its first frames: they guard numbers against accidental change.

They are this program's own, no truth: what is right is held by closed forms, laws and published numbers elsewhere.
    python -m tests.cases.test_golden --write [CASE ...]
makes them anew, of all cases or of those named; look at the diff.
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


def scalars(case: str, variant: str) -> dict[str, float]:
    """Return the numbers of a variant over its first frames.

    worst_volume_ratio: of all cells and frames the one furthest from 1. At the last frame: total_volume [m3] and
    kinetic plus elastic energy [J], which cannot cancel as a total with the loads' potential does.
    """
    resolved = load_case(CASES[case])
    count = min(FRAMES, resolved.schedule.frames)
    problem = build(load_case(CASES[case], overrides={"schedule.frames": count}).variant(variant))
    worst = 1.0
    for frame in frames(problem):
        ratio = measure(frame)["volume_ratio"]
        furthest = float(ratio[np.abs(ratio - 1).argmax()])
        worst = furthest if abs(furthest - 1) > abs(worst - 1) else worst
    last = measure(frame)
    return {
        "worst_volume_ratio": worst,
        "total_volume": float(last["total_volume"]),
        "energy": float(last["kinetic_energy"] + last["elastic_energy"]),
    }


def golden() -> dict[str, dict[str, dict[str, float]]]:
    return tomllib.loads(FILE.read_text(encoding="utf-8"))["case"] if FILE.exists() else {}


@pytest.mark.parametrize(("case", "variant"), VARIANTS)
def test_a_variant_has_its_golden_scalars(case, variant):
    wanted = golden().get(case, {}).get(variant)
    if wanted is None:
        pytest.fail(f"{case}/{variant} has no golden scalars; make them with: {COMMAND} {case}", pytrace=False)
    assert scalars(case, variant) == pytest.approx(wanted, rel=RTOL), f"if this is meant: {COMMAND} {case}"


def test_every_golden_scalar_belongs_to_a_variant():
    kept = {(case, variant) for case, variants in golden().items() for variant in variants}
    assert kept - set(VARIANTS) == set(), f"make them anew with: {COMMAND}"


def write(cases: list[str]) -> None:
    """Write the scalars of these cases anew; the others that still exist stay as they are."""
    table = {case: values for case, values in golden().items() if case in CASES and case not in cases}
    for case, variant in VARIANTS:
        if case in cases:
            table.setdefault(case, {})[variant] = scalars(case, variant)
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
    write(parser.parse_args().write or list(CASES))
