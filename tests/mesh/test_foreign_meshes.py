"""Meshes of cases as other programs leave them: each is understood, or refused with its reason; nothing is dropped."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import pipeline
from pipeline.cli import main
from pipeline.errors import MeshError
from pipeline.mesh.files import read_mesh
from tests.bodies import write_case
from tests.foreign import case_meshes as M

Check = Callable[[Path, Path], None]  # (path of the mesh, empty folder)
UNIT = ((0, 0, 0), (1, 1, 1))
BRICK = ((0, 0, 0), (1, 2, 3))
TURNED = ((8, 0, 0), (10, 1, 3))  # 1 x 2 x 3, turned by 90 degrees about z and moved by 10


class Situation(NamedTuple):
    """A mesh that `make` writes into a folder, its name there, and the check of the right value."""

    make: Callable[[Path], None]
    path: str
    check: Check


def fills(volume: float, bounds=UNIT, *, cells: int = 6, nodes: int = 8, note: str = "") -> Check:
    """The case's body has this volume, these bounds and counts, and the case's notes contain a text."""

    def check(path: Path, out: Path) -> None:
        problem = build_case(path, out, bounds)
        mesh = problem.body.mesh
        assert mesh.rest_volumes.sum() == pytest.approx(volume, rel=1e-9)
        assert np.array([mesh.points.min(0), mesh.points.max(0)]) == pytest.approx(np.array(bounds), abs=1e-7)
        assert (len(mesh.cells), len(mesh.points)) == (cells, nodes)
        assert any(note in text for text in problem.notes) if note else not problem.notes, problem.notes

    return check


def build_case(path: Path, out: Path, bounds=UNIT, scale: float = 1.0) -> pipeline.Problem:
    """The problem of a case that holds the lowest plane along x."""
    out.mkdir()
    supports, zero = [{"plane": "x", "at": float(bounds[0][0])}], [0.0] * len(bounds[0])
    document = {
        "mesh": {"file": str(path), "scale": scale},
        "supports": supports,
        "loads": {"gravity": zero},
        "initial": {"velocity": zero},
    }
    return pipeline.build(pipeline.load_case(write_case(out, **document)).variant("polar"))


def refuses(*words: str) -> Check:
    """The mesh is refused with these words in one line, and the program ends with exit code 2."""

    def check(path: Path, out: Path) -> None:
        with pytest.raises(MeshError) as caught:
            read_mesh(path)
        assert all(word in str(caught.value) for word in words), caught.value
        out.mkdir()
        case = write_case(out, mesh={"file": str(path)})
        assert main(["check", str(case)]) == 2

    return check


def holds_the_rounded_plane(path: Path, out: Path) -> None:
    """The plane x = 0 holds its four nodes, or a note says that more lie nearby."""
    problem = build_case(path, out, scale=0.001)
    held = np.count_nonzero(problem.body.mesh.points[problem.body.supports.nodes, 0] < 1e-3)
    assert held == 4 or any("lie within" in note for note in problem.notes), (held, problem.notes)


SITUATIONS = [
    Situation(M.abaqus, "two_parts.inp", fills(1.125, ((0, 0, 0), (2, 1, 1)), cells=12, nodes=16, note="2 instances")),
    Situation(M.abaqus, "two_instances.inp", fills(2, ((0, 0, 0), (6, 1, 1)), cells=12, nodes=16, note="2 instances")),
    Situation(M.abaqus, "moved_instance.inp", fills(6, TURNED)),
    Situation(M.abaqus, "system.inp", fills(6, TURNED)),
    Situation(M.abaqus, "two_node_blocks.inp", fills(1)),
    Situation(M.abaqus, "c3d4h.inp", fills(1)),
    Situation(M.abaqus, "c3d4t.inp", fills(1)),
    Situation(M.abaqus, "elset.inp", fills(1, note="STEEL")),
    Situation(M.abaqus, "cps3.inp", fills(1, ((0, 0), (1, 1)), cells=2, nodes=4)),
    Situation(M.abaqus, "ngen.inp", fills(1 / 6, cells=1, nodes=4, note="1 nodes that belong to no tetrahedron")),
    Situation(M.abaqus, "include.inp", fills(1)),
    Situation(M.abaqus, "sets_and_comments.inp", fills(1)),
    Situation(M.abaqus, "gaps.inp", fills(1)),
    *(
        Situation(M.encodings, f"{mode}_{compressor}_{order}_{raw}.vtu", fills(6, BRICK))
        for mode, compressor, order, raw in M.ENCODINGS
    ),
    *(
        Situation(M.encodings, f"legacy_{version}_{binary}.vtk", fills(6, BRICK))
        for version in (42, 51)
        for binary in (0, 1)
    ),
    Situation(M.formats, "one.ele", fills(6, BRICK)),
    Situation(M.formats, "zero.ele", fills(6, BRICK)),
    Situation(M.formats, "medit.mesh", fills(6, BRICK)),
    Situation(M.formats, "medit2.mesh", fills(6, BRICK, note="1 triangle")),
    Situation(M.formats, "ten_marked.bdf", fills(6, BRICK, note="middle")),
    Situation(M.formats, "ten_unmarked.bdf", fills(6, BRICK, note="middle")),
    Situation(M.formats, "version_1.msh", refuses("gmsh 1")),
    Situation(M.regions_and_noise, "regions.msh", fills(2, ((0, 0, 0), (2, 1, 1)), cells=12, nodes=12, note="rubber")),
    Situation(M.regions_and_noise, "nearly.vtu", refuses("8 nodes", "merge")),
    Situation(M.regions_and_noise, "exactly.vtu", refuses("4 nodes", "merge")),
    Situation(M.regions_and_noise, "flat_noise.vtu", fills(8, ((0, 0), (4, 2)), cells=16, nodes=15, note="along z")),
    Situation(
        M.regions_and_noise, "quadratic.vtu", fills(2, ((0, 0, 0), (2, 1, 1)), cells=12, nodes=12, note="middle")
    ),
    Situation(M.regions_and_noise, "rounded.vtu", holds_the_rounded_plane),
]


@pytest.mark.parametrize("situation", SITUATIONS, ids=lambda situation: situation.path)
def test_a_mesh_of_another_program_is_understood_or_refused(folders, tmp_path, situation):
    situation.check(folders(situation.make) / situation.path, tmp_path / "out")


@pytest.mark.parametrize("variant", ["one", "converged", "linear", "explicit"])
def test_the_numbering_and_the_unit_of_a_mesh_do_not_change_the_motion(folders, variant):
    def run(name: str) -> tuple[float, float]:
        problem = pipeline.build(pipeline.load_case(folders(M.renumbered) / f"{name}.toml").variant(variant))
        x = [frame.x for frame in pipeline.frames(problem)][-1]
        tip = problem.body.mesh.points[:, 0] > 3.99
        return float(x[tip, 2].sum()), float(x[:, 0].sum())

    plain = run("plain")
    assert plain[0] < 3.9  # nine nodes, which lie at 0, 0.5 and 1 at rest, have sunk
    for name in ("reordered", "turned", "millimeters", "mirrored"):
        assert run(name) == pytest.approx(plain, rel=1e-7), name
