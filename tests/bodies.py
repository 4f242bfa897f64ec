"""Small bodies, motions and case files that several tests share."""

import sys
import types
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import tomli_w
import xarray

from pipeline.case import MethodSpec, load_case
from pipeline.fem.body import Body, Formulation
from pipeline.fem.body_choice import make_body
from pipeline.fem.material import Material
from pipeline.fem.supports import Supports, rotation_about
from pipeline.mesh.element_mesh import ElementMesh
from pipeline.mesh.quadratic import QuadraticMesh, find_sides, make_quadratic_mesh, raise_order
from pipeline.mesh.shapes import box, rectangle
from pipeline.mesh.simplex import Mesh
from pipeline.problem.methods import LAWS, MASSES, ROTATIONS
from pipeline.problem.problem import Problem, build
from pipeline.problem.stage_solvers import make_stepper
from pipeline.stepping.state import State, Stepper

MATERIAL = Material(1e8, 0.33, 1000.0)  # that of the thesis' bar
METHODS = {
    "linear": {"law": "linear"},
    "polar": {"law": "corotational", "rotation": "polar"},
    "gram_schmidt": {"law": "corotational", "rotation": "gram_schmidt"},
}
BOXES = {
    "tetrahedra": box((2.0, 3.0, 1.0), (2, 3, 1)),
    "alternating": box((2.0, 3.0, 1.0), (2, 3, 1), "alternating"),
    "triangles": rectangle((2.0, 3.0), (2, 3)),
}


def bend_sides(mesh: QuadraticMesh, amount: float = 0.06) -> QuadraticMesh:
    """The mesh with the nodes in the middle of its sides moved by up to `amount` of the side along each axis."""
    ends, sides = find_sides(mesh.cells[:, : mesh.dimension + 1])
    middle = np.empty(len(ends), dtype=np.int64)
    middle[sides] = mesh.cells[:, mesh.dimension + 1 :]
    lengths = np.linalg.norm(np.diff(mesh.points[ends], axis=1), axis=2)
    points = mesh.points.copy()
    points[middle] += amount * lengths * np.random.default_rng(6).uniform(-1, 1, (len(middle), mesh.dimension))
    return make_quadratic_mesh(points, mesh.cells, mesh.name)


# as BOXES, of order 2
QUADRATIC = {
    "tetrahedra": raise_order(BOXES["tetrahedra"]),
    "triangles": raise_order(BOXES["triangles"]),
    "curved tetrahedra": bend_sides(raise_order(BOXES["tetrahedra"])),
    "curved triangles": bend_sides(raise_order(BOXES["triangles"])),
}


def make_thesis_bar(split: str = "kuhn") -> Mesh:
    return box((4.0, 12.0, 4.0), (2, 8, 2), split)


def make_solid(
    mesh: ElementMesh,
    law: str = "linear",
    rotation: str = "polar",
    *,
    material: Material = MATERIAL,
    held: Iterable[int] = (),
    load: np.ndarray | None = None,
    mass: str = "consistent",
    **formulation: str,
) -> Body:
    """A body of the law, mass and formulation (rotation_at, volumetric) with these names in a case."""
    nodes = np.array(list(held), dtype=np.int64)
    force = np.zeros_like(mesh.points) if load is None else load
    parts = (LAWS[law].part(material, ROTATIONS[rotation].part), Supports(nodes), force, MASSES[mass].part)
    return make_body(mesh, *parts, formulation=Formulation(**formulation))  # type: ignore[arg-type]  # names of the case


def make_clamped_bar(**keywords: object) -> Body:
    mesh = make_thesis_bar(str(keywords.pop("split", "kuhn")))
    return make_solid(mesh, held=np.flatnonzero(mesh.points[:, 1] == 12.0), **keywords)  # type: ignore[arg-type]  # checked by the call


def prepare_stepper(body: Body, dt: float, **method: object) -> Stepper:
    """A stepper of the method; backward Euler unless `stepper` names another."""
    spec = MethodSpec(**method)  # type: ignore[arg-type]  # pydantic checks them
    return make_stepper(body, dt, spec)


def find_equilibrium(body: Body) -> np.ndarray:
    """The positions at rest under the body's load: steps of backward Euler so long that inertia does not count."""
    v = np.zeros_like(body.mesh.points)
    *_, before, last = list_states(body, 1e5, 12, v, iterations="converged")
    assert np.abs(last.x - before.x).max() < 1e-6 * body.mesh.size
    return last.x


def list_states(body: Body, dt: float, steps: int, v: np.ndarray, x: np.ndarray | None = None, **method) -> list[State]:
    """The states 0 to `steps` of a body, by backward Euler unless `stepper` names another."""
    prepared = prepare_stepper(body, dt, **method)
    states = [State(0, body.mesh.points if x is None else x, v)]
    for _ in range(steps):
        states.append(prepared.step(states[-1])[0])
    return states


def make_spin(body: Body, omega: np.ndarray) -> np.ndarray:
    """The velocities omega x (X - center of mass); in the plane only the last component of omega counts."""
    X = body.mesh.points - body.lumped_mass @ body.mesh.points / body.lumped_mass.sum()
    if X.shape[1] == 2:
        return omega[-1] * np.stack([-X[:, 1], X[:, 0]], axis=1)
    return np.cross(omega, X)


def make_rotation(d: int, axis: Iterable[float], angle: float) -> np.ndarray:
    """A rotation matrix (d, d); in the plane it is always about z."""
    if d == 2:
        return rotation_about(np.array([0.0, 0.0, 1.0]), angle)[:2, :2]
    return rotation_about(np.array(list(axis), dtype=float), angle)


def case_document(**sections: object) -> dict[str, object]:
    """A clamped beam of 18 tetrahedra, three variants, four frames; sections set to None are left out."""
    document: dict[str, object] = {
        "name": "beam",
        "mesh": {"shape": "box", "size": [1.0, 3.0, 1.0], "cells": [1, 3, 1]},
        "material": {"youngs_modulus": 1e7, "poisson_ratio": 0.3, "density": 1000.0},
        "supports": [{"plane": "y", "at": 3.0}],
        "loads": {"gravity": [0.0, 0.0, -9.81]},
        "initial": {"velocity": [0.0, 0.0, -20.0]},
        "schedule": {"dt": 0.02, "frames": 4},
        "variants": {
            "linear": {"method.law": "linear"},
            "gram_schmidt": {"method.rotation": "gram_schmidt"},
            "polar": {},
        },
    }
    return {key: value for key, value in (document | sections).items() if value is not None}


PLANAR = {
    "mesh": {"shape": "rectangle", "size": [1.0, 3.0], "cells": [2, 6]},
    "loads": {"gravity": [0.0, -9.81]},
    "initial": {"velocity": [20.0, 0.0]},
}


def write_case(folder: Path, name: str = "beam.toml", **sections: object) -> Path:
    path = folder / name
    path.write_text(tomli_w.dumps(case_document(**sections)), encoding="utf-8")
    return path


def build_problem(folder: Path, variant: str = "polar", **sections: object) -> Problem:
    return build(load_case(write_case(folder, **sections)).variant(variant))


def skip_figures(monkeypatch) -> None:
    """Write empty files instead of figures, which have their own tests and take a second each."""
    blank = types.ModuleType("pipeline.views.plots")
    for name in ("write_volume_figure", "write_energy_figure", "write_effort_figure", "write_distance_figure"):
        setattr(blank, name, lambda dataset, path, *, title: path.touch())
    monkeypatch.setitem(sys.modules, blank.__name__, blank)


def assert_conventional(dataset: xarray.Dataset) -> None:
    """CF-1.11: units and a long_name for every number, a long_name for every label, no missing coordinate."""
    assert dataset.attrs["Conventions"].split()[0] == "CF-1.11" and dataset.attrs["title"]
    for key in ("units", "long_name"):
        bare = [name for name, variable in dataset.variables.items() if not variable.attrs.get(key)]
        bare = [name for name in bare if key == "long_name" or dataset[name].dtype == np.float64]
        assert bare == [], f"without {key}: {bare}"
    filled = [name for name in dataset.indexes if dataset[name].encoding.get("_FillValue") is not None]
    assert filled == [], f"coordinates with a fill value, which CF appendix A forbids: {filled}"
