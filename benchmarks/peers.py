"""The costs of other programs on the same mesh, if they are installed.

No peer is required: without it there is no row. Each row has the ms and ns_per_tet of the peer, `ours_ms` of our
nearest counterpart, measured in the same process on the same mesh, and `differs`: the differences between the two.
"""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np

from pipeline.errors import MeshError, SolveError
from pipeline.problem.problem import Problem
from pipeline.studies.scaling.rival import Rival
from pipeline.studies.scaling.step_cost import build_point, measure_median_ms, read_peak_megabytes

_WARM_STEPS = 5  # so that the cells have turned before ours is timed
# MuJoCo warns if a step needs more iterations than this; a step of 0.07 s may exceed the default of 100
_MUJOCO_ITERATIONS = 1000


class PeerCosts(NamedTuple):
    """Milliseconds of a peer and of our nearest counterpart, and seconds of the peer's set-up."""

    ms: float
    ours_ms: float
    setup_s: float


class Peer(NamedTuple):
    """The package, a noun for the part that is measured, the function that measures it, its differences and color."""

    module: str
    part: str
    measure: Callable[[Problem], PeerCosts]
    differs: str
    color: str


def _measure_felupe(problem: Problem) -> PeerCosts:
    """Return the costs of felupe's stiffness of linear elasticity at rest, and of our linearization."""
    import felupe

    body, material = problem.body, problem.body.material
    began = time.perf_counter()
    region = felupe.RegionTetra(felupe.Mesh(body.mesh.points, body.mesh.cells, "tetra"))
    field = felupe.FieldContainer([felupe.Field(region, dim=3)])
    law = felupe.LinearElastic(E=material.youngs_modulus, nu=material.poisson_ratio)
    solid = felupe.SolidBody(law, field)
    setup = time.perf_counter() - began
    stepper, state = problem.prepare(), problem.start
    for _ in range(_WARM_STEPS):
        state, _ = stepper.step(state)
    ours = measure_median_ms(lambda: body.linearize(state.x))
    return PeerCosts(measure_median_ms(lambda: solid.assemble.matrix(field)), ours, setup)


def _measure_mujoco(problem: Problem) -> PeerCosts:
    """Return the costs of a step of MuJoCo's flex, and of ours; raises SolveError if MuJoCo warns."""
    import mujoco

    with capture_warnings() as warnings:
        began = time.perf_counter()
        model, data = make_flex(problem)
        setup = time.perf_counter() - began
        warnings.clear()  # it reports missing passive forces, although elasticity is set
        ms = measure_median_ms(lambda: mujoco.mj_step(model, data))
    if warnings:
        raise SolveError(f"MuJoCo warned {len(warnings)} times, first: {' '.join(warnings[0].split())}")
    stepper, state = problem.prepare(), problem.start

    def step() -> None:
        nonlocal state
        state, _ = stepper.step(state)

    return PeerCosts(ms, measure_median_ms(step), setup)


@contextmanager
def capture_warnings() -> Iterator[list[str]]:
    """Yield a list of MuJoCo's warnings, which it would otherwise print and write to a file."""
    import mujoco

    warnings: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(warnings.append)
    try:
        yield warnings
    finally:
        mujoco.set_mju_user_warning(before)


def make_flex(problem: Problem) -> tuple[Any, Any]:
    """Return MuJoCo's model and data of a problem: its tetrahedra, material, pinned nodes, loads, start and step."""
    import mujoco

    body, material = problem.body, problem.body.material
    points, cells, held = body.mesh.points, body.mesh.cells, body.supports.nodes
    pins = f'<pin id="{_format_numbers(held)}"/>' if held.size else ""
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><size memory="2G"/><option timestep="{problem.dt!r}" integrator="discrete" gravity="0 0 0" '
        f'iterations="{_MUJOCO_ITERATIONS}"><flag contact="disable"/></option><worldbody>'
        f'<flexcomp name="body" type="direct" dim="3" radius="0.001" '
        f'mass="{material.density * float(body.mesh.rest_volumes.sum())!r}" '
        f'point="{_format_numbers(points)}" element="{_format_numbers(cells)}">'
        f'<elasticity young="{material.youngs_modulus!r}" poisson="{material.poisson_ratio!r}"/>'
        f'<contact contype="0" conaffinity="0" selfcollide="none"/>{pins}</flexcomp></worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    data.qvel[:] = problem.start.v[body.free].ravel()
    data.xfrc_applied[model.flex_vertbodyid[body.free], :3] = body.load[body.free]
    return model, data


def _format_numbers(array: "np.ndarray[Any, Any]") -> str:
    return " ".join(map(repr, array.ravel().tolist()))


PEERS: Mapping[str, Peer] = {
    "felupe": Peer(
        "felupe",
        "an assembly",
        _measure_felupe,
        "an assembly, no step: felupe's is the stiffness of linear elasticity at rest, ours the rotations, forces and "
        "corotational stiffness of a moving state, of which it stores one triangle",
        "#a6761d",
    ),
    "mujoco": Peer(
        "mujoco",
        "a step",
        _measure_mujoco,
        'a step of the same dt: Saint Venant-Kirchhoff elasticity, integrator "discrete" (one solve with M + h^2 K), '
        "tolerance 1e-8 of its own kind, the mass equal on all nodes, supports at rest; ours one_solve, corotational",
        "#6a3d9a",
    ),
}


def list_installed() -> list[str]:
    """Return the names of the peers that can be imported."""
    return [name for name, peer in PEERS.items() if find_spec(peer.module) is not None]


def make_rival(name: str) -> Rival:
    """Return a peer as a rival of the scaling study."""
    peer = PEERS[name]
    return Rival(name, f"{__name__}:measure_peer", f"{name}, {peer.part}", peer.color, peer.differs)


def measure_peer(settings: dict[str, Any]) -> dict[str, Any]:
    """Return the row of one peer on one mesh; raises MeshError for a planar mesh, SolveError if the peer fails."""
    name = settings["method"]
    peer = PEERS[name]
    problem = build_point(settings | {"method": "one_solve"})
    cells = len(problem.body.mesh.cells)
    if problem.body.mesh.dimension != 3:
        raise MeshError(f"{name} is measured with tetrahedra only")
    costs = peer.measure(problem)
    return {
        "method": name,
        "version": str(import_module(peer.module).__version__),
        "cells": settings.get("cells"),
        "tets": cells,
        "nodes": len(problem.body.mesh.points),
        "dt": problem.dt,
        "ms": costs.ms,
        "ns_per_tet": 1e6 * costs.ms / cells,
        "ours_ms": costs.ours_ms,
        "setup_s": costs.setup_s,
        "differs": peer.differs,
        "peak_MB": read_peak_megabytes(),
    }
