"""Kernels are compiled, or loaded, in the set-up, where the progress bar says so, and in no timed step."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

# each in a process of its own: what another test has loaded would not be missed
CODE = """
import gc, sys
from numba.core.registry import CPUDispatcher
from pipeline import build, load_case

def loaded():
    kernels = [one for one in gc.get_objects() if isinstance(one, CPUDispatcher)]
    return {f"{one.py_func.__module__}.{one.py_func.__name__} {of}" for one in kernels for of in one.signatures}

case, variant, keys = sys.argv[1], sys.argv[2], eval(sys.argv[3])
problem = build(load_case(case, overrides=keys).variant(variant))
stepper, state = problem.prepare(), problem.start
before = loaded()
for _ in range(4):
    state, _ = stepper.step(state)
assert before, "no kernel at all"
print(*sorted(loaded() - before), sep="\\n")
"""
EXPLICIT = {"method.stepper": "symplectic_euler", "method.mass": "lumped", "schedule.dt": 1e-4}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "variant", "keys"),
    [
        ("bar", "linear", {}),
        ("bar", "polar", {}),
        ("bar", "polar", {"method.linear_solver": "cg"}),
        ("bar", "polar", {"method.linear_solver": "warped", "method.stepper": "bdf2"}),
        ("bar", "polar", {"method.linear_solver": "multigrid", "method.iterations": 2}),
        ("bar", "polar", {"method.model": "auto"}),
        ("bar", "polar", {"method.inversion": "last"}),
        ("bar", "converged", {}),
        ("bar", "polar", EXPLICIT),
        ("twisted_bar", "one_solve", {}),
        ("bar", "polar", {"mesh.order": 2}),
        ("bar", "polar", {"mesh.order": 2, "method.model": "auto", "method.linear_solver": "multigrid"}),
        ("bar", "converged", {"mesh.order": 2}),
        ("bar", "linear", {"mesh.order": 2}),
        ("bar", "polar", {"mesh.order": 2, "method.rotation_at": "element"}),
        ("bar", "polar", {"mesh.order": 2, "method.inversion": "last"}),
        ("bar", "polar", EXPLICIT | {"mesh.order": 2}),
        ("swing2d", "bdf2", {"mesh.order": 2, "method.model": "auto"}),
        ("swing2d", "symplectic", {"mesh.order": 2, "schedule.dt": 1e-4}),
        ("swing2d", "symplectic", {}),
        ("swing2d", "bdf2", {"method.model": "auto"}),
    ],
    ids=str,
)
def test_no_step_compiles_or_loads_a_kernel(cases_folder, case: str, variant: str, keys: dict[str, object]) -> None:
    command = [sys.executable, "-c", CODE, str(cases_folder / f"{case}.toml"), variant, repr(keys)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.split(), done.stderr) == (0, [], "")
