"""Materials by groups and fields of mesh files: gmsh, Abaqus, Nastran, vtu, medit; both orders, refined, both ways."""

from pathlib import Path

import meshio
import numpy as np
import pytest
import pyvista

from pipeline.case.model import load_case, validate_case
from pipeline.errors import CaseError
from pipeline.mesh.files import read_mesh
from pipeline.mesh.shapes import box
from pipeline.problem.materials import number_materials
from pipeline.problem.problem import build, build_mesh
from pipeline.problem.python_case import make_case

SOFT = {"youngs_modulus": 1e6, "poisson_ratio": 0.3, "density": 1000.0}
STIFF = {"youngs_modulus": 9e6, "poisson_ratio": 0.2, "density": 3000.0}
BAR = box([4.0, 1.0, 1.0], [4, 1, 1], "kuhn")
HARD = BAR.centers[:, 0] > 2.0  # of each cell
ORDERS = pytest.mark.parametrize("order", [1, 2])


def document(mesh, materials, **sections):
    return {
        "name": "bar", "mesh": mesh, "material": SOFT, "materials": materials, "schedule": {"dt": 0.01, "frames": 2},
        "supports": [{"plane": "x", "at": 0.0}], "loads": {"gravity": [0.0, 0.0, -10.0]}, **sections,
    }  # fmt: skip


def make_file_case(path, materials, order=1, refine=0, **sections):
    mesh = {"file": path.name, "order": order, "refine": refine}
    return validate_case(document(mesh, materials, **sections), path.parent / "bar.toml")


def write_gmsh(path, version):
    """Two blocks, whose cells alternate with those of the mesh, and the sides as triangles of a group of their own."""
    blocks = [("tetra", BAR.cells[~HARD]), ("triangle", BAR.cells[:2, :3]), ("tetra", BAR.cells[HARD])]
    numbers = [np.full(len(cells), number) for (_, cells), number in zip(blocks, (3, 3, 7), strict=True)]
    names = {"soft": np.array([3, 3]), "sides": np.array([3, 2]), "hard": np.array([7, 3])}
    entities = [np.full(len(cells), i + 1) for i, (_, cells) in enumerate(blocks)]
    data = {"gmsh:physical": numbers, "gmsh:geometrical": entities}
    if version == "gmsh":  # version 4.1: points name their entities, too
        dims = np.resize([[3, 1], [2, 2], [3, 3]], (len(BAR.points), 2))
        mesh = meshio.Mesh(BAR.points, blocks, {"gmsh:dim_tags": dims}, data, field_data=names)
    else:
        mesh = meshio.Mesh(BAR.points, blocks, cell_data=data, field_data=names)
    mesh.write(path, file_format=version, binary=False)
    return path


def write_abaqus(path):
    lines = ["*HEADING", "*NODE"]
    lines += [f"{i + 1}, {x!r}, {y!r}, {z!r}" for i, (x, y, z) in enumerate(BAR.points.tolist())]
    lines += ["*ELEMENT, TYPE=C3D4, ELSET=ALL"]
    lines += [f"{10 * (i + 1)}, " + ", ".join(str(n + 1) for n in cell) for i, cell in enumerate(BAR.cells)]
    hard, soft = (10 * (np.flatnonzero(chosen) + 1) for chosen in (HARD, ~HARD))
    for name, ids in (("Hard", hard), ("SOFT", soft)):
        lines += [f"*ELSET, ELSET={name}", *(", ".join(map(str, ids[k : k + 8])) for k in range(0, len(ids), 8))]
    lines += ["*ELSET, ELSET=BOTH", "Hard, soft", "*ELSET, ELSET=FIRST, GENERATE", "10, 30, 10"]
    lines += ["*SOLID SECTION, ELSET=HARD, MATERIAL=STEEL", "*SOLID SECTION, ELSET=SOFT, MATERIAL=RUBBER"]
    path.write_text("\n".join(lines) + "\n")
    return path


def write_nastran(path):
    lines = ["BEGIN BULK", *(f"GRID,{i + 1},,{x},{y},{z}" for i, (x, y, z) in enumerate(BAR.points.tolist()))]
    for i, cell in enumerate(BAR.cells):
        lines.append(f"CTETRA,{i + 1},{7 if HARD[i] else 3}," + ",".join(str(n + 1) for n in cell))
    path.write_text("\n".join([*lines, "ENDDATA"]) + "\n")
    return path


def write_field(path, dtype=np.int32):
    """Also triangles, which have another value, and a field that is not of whole numbers."""
    cells = [("triangle", BAR.cells[:1, :3]), ("tetra", BAR.cells)]
    parts = [np.full(1, 99), np.where(HARD, 7, 3)]
    data = {"part": [a.astype(dtype) for a in parts], "MaterialIds": parts, "heat": [a + 0.5 for a in parts]}
    first = path.with_suffix(".vtu") if path.suffix == ".vtk" else path
    meshio.Mesh(BAR.points, cells, cell_data=data).write(first)
    if first != path:
        pyvista.read(first).save(path)
    return path


def write_medit(path):
    meshio.Mesh(BAR.points, [("tetra", BAR.cells)], cell_data={"medit:ref": [np.where(HARD, 7, 3)]}).write(path)
    return path


FILES = {
    "gmsh 2.2 by name": (lambda folder: write_gmsh(folder / "bar.msh", "gmsh22"), {"group": "hard"}),
    "gmsh 2.2 by number": (lambda folder: write_gmsh(folder / "bar.msh", "gmsh22"), {"group": "7"}),
    "gmsh 4.1 by name": (lambda folder: write_gmsh(folder / "bar.msh", "gmsh"), {"group": "hard"}),
    "gmsh 4.1 by number": (lambda folder: write_gmsh(folder / "bar.msh", "gmsh"), {"group": "7"}),
    "gmsh field": (lambda folder: write_gmsh(folder / "bar.msh", "gmsh22"), {"field": "gmsh:physical", "value": 7}),
    "Abaqus set": (lambda folder: write_abaqus(folder / "bar.inp"), {"group": "Hard"}),
    "Abaqus set in capitals": (lambda folder: write_abaqus(folder / "bar.inp"), {"group": "HARD"}),
    "Abaqus section": (lambda folder: write_abaqus(folder / "bar.inp"), {"group": "steel"}),
    "Nastran": (lambda folder: write_nastran(folder / "bar.bdf"), {"group": "property 7"}),
    "Nastran by number": (lambda folder: write_nastran(folder / "bar.bdf"), {"group": "7"}),
    "vtu field": (lambda folder: write_field(folder / "bar.vtu"), {"field": "part", "value": 7}),
    "vtu field of floats": (lambda folder: write_field(folder / "bar.vtu", np.float64), {"field": "part", "value": 7}),
    "vtu group": (lambda folder: write_field(folder / "bar.vtu"), {"group": "MaterialIds 7"}),
    "vtk field": (lambda folder: write_field(folder / "bar.vtk"), {"field": "part", "value": 7}),
    "xdmf field": (lambda folder: write_field(folder / "bar.xdmf"), {"field": "part", "value": 7}),
    "medit": (lambda folder: write_medit(folder / "bar.mesh"), {"group": "reference 7"}),
}


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize(("order", "refine"), [(1, 0), (2, 0), (1, 1), (2, 1)])
def test_a_bar_of_two_materials_from_a_file_is_that_of_a_half_space(tmp_path, name, order, refine):
    write, selector = FILES[name]
    path = write(tmp_path)
    case = make_file_case(path, [STIFF | selector], order, refine)
    same = make_file_case(path, [STIFF | {"above": {"axis": "x", "at": 2.0}}], order, refine)
    mesh = build_mesh(case)
    numbers = number_materials(case, mesh)
    assert np.array_equal(numbers, number_materials(same, mesh)) and numbers.sum() == HARD.sum() * 8**refine
    one, other = build(case).body, build(same).body
    x = mesh.points * [1.01, 0.99, 1.02]
    assert np.array_equal(one.force(x), other.force(x)) and np.array_equal(one.load, other.load)
    assert not any("get the one material" in note for note in build(case).notes)


def test_the_note_on_regions_stays_if_the_case_has_one_material(tmp_path):
    path = write_gmsh(tmp_path / "bar.msh", "gmsh22")
    assert "bar.msh: 2 regions (soft, hard) get the one material of the case" in build(make_file_case(path, [])).notes


def test_cells_listed_once_for_each_group_are_in_all_of_them(tmp_path):
    twice = np.concatenate([BAR.cells, BAR.cells[HARD]])
    numbers = np.concatenate([np.full(len(BAR.cells), 3), np.full(HARD.sum(), 7)])
    names = {"all": np.array([3, 3]), "hard": np.array([7, 3])}
    data = {"gmsh:physical": [numbers], "gmsh:geometrical": [numbers]}
    order = np.argsort(np.random.default_rng(0).random(len(twice)))
    cells = [("tetra", twice[order])]
    data = {key: [values[0][order]] for key, values in data.items()}
    path = tmp_path / "bar.msh"
    meshio.Mesh(BAR.points, cells, cell_data=data, field_data=names).write(path, file_format="gmsh22", binary=False)
    mesh = read_mesh(path)
    hard = mesh.points[mesh.cells].mean(axis=1)[:, 0] > 2.0
    assert len(mesh.cells) == len(BAR.cells)
    assert np.array_equal(mesh.regions.find_group("hard"), np.flatnonzero(hard))
    assert np.array_equal(mesh.regions.find_group("all"), np.arange(len(BAR.cells)))
    assert np.array_equal(mesh.regions.find_values("gmsh:physical", 7), np.flatnonzero(hard))


ENTITIES = """$MeshFormat
4.1 0 8
$EndMeshFormat
$PhysicalNames
2
3 1 "all"
3 2 "tip"
$EndPhysicalNames
$Entities
0 0 0 3
1 0 0 0 1 1 1 {first}0
2 1 0 0 2 1 1 2 1 2 0
3 2 0 0 3 1 1 1 9 0
$EndEntities
$Nodes
1 6 1 6
3 1 0 6
1
2
3
4
5
6
0 0 0
1 0 0
0 1 0
0 0 1
1 1 1
3 1 1
$EndNodes
$Elements
3 3 1 3
3 1 4 1
1 1 2 3 4
3 2 4 1
2 2 3 4 5
3 3 4 1
3 3 4 6 5
$EndElements
"""


@pytest.mark.parametrize("first", ["1 1 ", "0 "])
def test_entities_of_gmsh_may_be_in_several_groups_or_in_none(tmp_path, first):
    path = tmp_path / "bar.msh"
    path.write_text(ENTITIES.format(first=first))
    regions = read_mesh(path).regions
    assert regions.find_group("all").tolist() == ([0, 1] if first == "1 1 " else [1])
    assert regions.find_group("tip").tolist() == [1] and regions.find_group("9").tolist() == [2]


def test_sets_of_instances_and_of_sets_in_abaqus_files(tmp_path):
    nodes = [f"{i + 1}, {', '.join(map(repr, p))}" for i, p in enumerate(BAR.points.tolist())]
    elements = [f"{i + 1}, " + ", ".join(str(n + 1) for n in cell) for i, cell in enumerate(BAR.cells)]
    text = ["*PART, NAME=P", "*NODE", *nodes, "*ELEMENT, TYPE=C3D4", *elements, "*ELSET, ELSET=End", "1, 2"]
    text += ["*ELSET, ELSET=Broken", "Nowhere", "*END PART", "*ASSEMBLY, NAME=A"]
    for k in range(2):
        text += [f"*INSTANCE, NAME=I{k}, PART=P", f"0, {3 * k}, 0", "*END INSTANCE"]
    text += ["*ELSET, ELSET=One, INSTANCE=I1", "3, 4", "*ELSET, ELSET=Two", "I0.5, I1.End", "*ELSET, ELSET=Sum", "One"]
    (tmp_path / "two.inp").write_text("\n".join([*text, "*END ASSEMBLY"]) + "\n")
    mesh, e = read_mesh(tmp_path / "two.inp"), len(BAR.cells)
    assert mesh.regions.find_group("end").tolist() == [0, 1, e, e + 1]
    assert mesh.regions.find_group("One").tolist() == [e + 2, e + 3]
    assert mesh.regions.find_group("Two").tolist() == [4, e, e + 1]
    assert [name for name, *_ in mesh.regions.groups] == ["End", "Two", "One"]
    assert any(note.endswith("sets of sets that are not defined here are not read: Sum, Broken") for note in mesh.notes)


@pytest.mark.parametrize(
    ("selector", "message"),
    [
        ({"group": "wood"}, r"materials\.0\.group: 'wood' is not a group; the groups are soft \(3\), hard \(7\)$"),
        ({"field": "x", "value": 1}, r"0\.field: 'x' is not a field of whole numbers on cells; the .* gmsh:physical"),
        ({"field": "gmsh:physical", "value": 4}, r"0\.field: no cell has 4 in 'gmsh:physical'; its values are 3, 7$"),
        ({"field": "gmsh:physical"}, r"materials\.0\.value: missing"),
        ({"value": 1, "cells": [0]}, r"materials\.0\.value: needs field, which is not given"),
        ({"field": "x", "value": 1.5}, r"materials\.0\.value: 1\.5 is not an integer"),
        ({"group": "hard", "cells": [0]}, r"materials\.0: group and cells cannot be combined"),
        ({"group": 7}, r"materials\.0\.group: 7 is not a string"),
    ],
)
def test_wrong_groups_and_fields_are_refused_in_one_line(tmp_path, selector, message):
    path = write_gmsh(tmp_path / "bar.msh", "gmsh22")
    with pytest.raises(CaseError, match=message) as caught:
        build(make_file_case(path, [STIFF | selector]))
    assert "\n" not in str(caught.value)


def test_shapes_and_arrays_have_no_groups():
    mesh = {"shape": "box", "size": [1.0, 1.0, 1.0], "cells": [1, 1, 1]}
    case = validate_case(document(mesh, [STIFF | {"group": "hard"}]), Path("bar.toml"))
    with pytest.raises(CaseError, match=r"materials\.0\.group: a mesh of shape = 'box' has no groups: it needs mesh"):
        build(case)
    with pytest.raises(CaseError, match=r"materials\.0\.field: a mesh of arrays from Python has no fields"):
        build(make_case("bar", mesh=BAR, material=SOFT, schedule={"dt": 0.01, "frames": 1},
                        materials=[STIFF | {"field": "part", "value": 1}]))  # fmt: skip


def test_the_material_may_be_left_out_if_entries_cover_all_cells(tmp_path):
    path = write_abaqus(tmp_path / "bar.inp")
    mesh, both = {"file": path.name}, [STIFF | {"group": "Hard"}, SOFT | {"group": "SOFT"}]
    sections = document(mesh, both)
    del sections["material"]
    one = build(validate_case(sections, tmp_path / "bar.toml")).body
    other = build(make_file_case(path, both[:1])).body
    x = one.mesh.points * [1.01, 0.99, 1.02]
    assert np.array_equal(one.force(x), other.force(x)) and one.damping == other.damping
    with pytest.raises(CaseError, match=r"materials: 12 of 24 cells have no material, first cell 0 with its center at"):
        build(validate_case(sections | {"materials": both[:1]}, tmp_path / "bar.toml"))
    with pytest.raises(CaseError, match=r"bar\.toml: material: missing$"):
        validate_case(sections | {"materials": []}, tmp_path / "bar.toml")


def test_materials_from_python():
    sections = {"schedule": {"dt": 0.01, "frames": 1}, "mesh": BAR}
    above, below = ({side: {"axis": "x", "at": 2.0}} for side in ("above", "below"))
    case = make_case("bar", material=SOFT, materials=[STIFF | above], **sections)
    assert number_materials(case, build_mesh(case)).tolist() == HARD.astype(int).tolist()
    case = make_case("bar", materials=[STIFF | above, SOFT | below], **sections)
    assert build(case).body.material.density.tolist() == np.where(HARD, 3000.0, 1000.0).tolist()
    with pytest.raises(CaseError, match=r"materials\.0\.mass_damping: unknown key") as caught:
        make_case("bar", material=SOFT, materials=[STIFF | above | {"mass_damping": 1.0}], **sections)
    assert "\n" not in str(caught.value)


def test_variants_and_overrides_change_materials(tmp_path):
    write_gmsh(tmp_path / "bar.msh", "gmsh22")
    path = tmp_path / "bar.toml"
    path.write_text(
        'name = "bar"\nmesh = { file = "bar.msh" }\nschedule = { dt = 0.01, frames = 1 }\n'
        "material = { youngs_modulus = 1e6, poisson_ratio = 0.3, density = 1000.0 }\n"
        '[[materials]]\ngroup = "hard"\nyoungs_modulus = 9e6\nposson_ratio = 0.2\ndensity = 3000.0\n'
        '[variants.same]\n[variants.light]\n"materials.0.density" = 10.0\n'
        '[variants.other]\nmaterials = [{ group = "soft", youngs_modulus = 9e6, poisson_ratio = 0.2, density = 7.0 }]\n'
        "[variants.one]\nmaterials = []\n".replace("posson", "poisson")
    )
    case = load_case(path)
    hard = build_mesh(case).centers[:, 0] > 2.0
    values = {name: build(case.variant(name)).body.material.density for name in case.variant_names}
    assert values["same"].tolist() == np.where(hard, 3000.0, 1000.0).tolist()
    assert values["light"].tolist() == np.where(hard, 10.0, 1000.0).tolist()
    assert values["other"].tolist() == np.where(hard, 1000.0, 7.0).tolist()
    assert values["one"] == 1000.0
    changed = load_case(path, overrides={"materials.0.group": "soft"}).variant("same")
    assert build(changed).body.material.density.tolist() == np.where(hard, 1000.0, 3000.0).tolist()
