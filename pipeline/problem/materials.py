"""The material of every cell: that of the case, replaced in regions."""

from typing import Any

import numpy as np

from pipeline.arrays import Floats, Ints
from pipeline.case import Case
from pipeline.errors import MeshError, quote_value
from pipeline.fem.material import Material, MaterialValues
from pipeline.mesh.element_mesh import ElementMesh
from pipeline.problem.conditions import find_inside


def make_material(case: Case, numbers: Ints | None) -> Material:
    """Return the material of a case: numbers, or arrays (e,) of those values in which its regions differ.

    `numbers` are those of number_materials.
    """
    specs = (case.material, *case.materials)
    return Material(*(_spread(specs, key, numbers) for key in ("youngs_modulus", "poisson_ratio", "density")))


def number_materials(case: Case, mesh: ElementMesh) -> Ints | None:
    """Return the number of every cell's material (e,): 0 is `material`, i + 1 is materials.i; None without regions.

    Later regions replace earlier ones. Raises CaseError for a region without cells or of which none remain, and for
    cells without a material.
    """
    if not case.materials:
        return None
    numbers = np.zeros(len(mesh.cells), dtype=np.int64)
    for i, region in enumerate(case.materials):
        numbers[_select_cells(case, f"materials.{i}", region, mesh)] = i + 1
    counts = np.bincount(numbers, minlength=len(case.materials) + 1)
    for i, count in enumerate(counts[1:]):
        if not count:
            raise case.make_error(f"materials.{i}", "all of its cells belong to later entries; change their order")
    if counts[0] and case.material is None:
        first = int(np.flatnonzero(numbers == 0)[0])
        X = _find_centers(mesh)[first].tolist()
        left = f"{counts[0]} of {len(numbers)} cells have no material, first cell {first} with its center at {X}"
        raise case.make_error("materials", f"{left}; give material for them, or more entries")
    return numbers


def describe_materials(case: Case, mesh: ElementMesh, numbers: Ints | None) -> list[str]:
    """Return a line for each material with its number of cells and their volume; none without regions.

    `numbers` are those of number_materials.
    """
    if numbers is None:
        return []
    unit = "m3" if mesh.dimension == 3 else "m2"
    lines = []
    for i, spec in enumerate((case.material, *case.materials)):
        if spec is None:
            continue
        cells = numbers == i
        name = "material" if i == 0 else f"materials.{i - 1}"
        lines.append(
            f"{name}: {int(cells.sum())} cells, {mesh.rest_volumes[cells].sum():.6g} {unit}, youngs_modulus = "
            f"{spec.youngs_modulus:g}, poisson_ratio = {spec.poisson_ratio:g}, density = {spec.density:g}"
        )
    return lines


def _spread(specs: tuple[Any, ...], key: str, numbers: Ints | None) -> MaterialValues:
    """Return the value of all materials, or that of every cell if they differ."""
    values = [np.nan if spec is None else float(getattr(spec, key)) for spec in specs]
    used = [values[i] for i in (np.unique(numbers) if numbers is not None else [0])]
    if len(set(used)) == 1:
        return used[0]
    assert numbers is not None
    return np.asarray(np.array(values)[numbers], dtype=np.float64)


def _select_cells(case: Case, key: str, region: Any, mesh: ElementMesh) -> Ints:
    """Return the cells of a region; raises CaseError if there are none."""
    if region.group is not None or region.field is not None:
        return _find_in_file(case, key, region, mesh)
    if region.cells is not None:
        return _find_children(case, key, region.cells, mesh)
    centers = _find_centers(mesh)
    mask = find_inside(case, key, region, centers, mesh.size)
    if not mask.any():
        low, high = centers.min(axis=0), centers.max(axis=0)
        raise case.make_error(key, f"selects no cell; the centers of cells span {low.tolist()} to {high.tolist()}")
    return np.flatnonzero(mask)


def _find_in_file(case: Case, key: str, region: Any, mesh: ElementMesh) -> Ints:
    """Return the cells of a group, or with a value in a field, of the file that the mesh comes from."""
    selector = "group" if region.group is not None else "field"
    if mesh.regions is None:
        source = f"shape = {quote_value(case.mesh.shape)}" if case.mesh.shape is not None else "arrays from Python"
        remedy = "needs mesh.file; choose cells by box, sphere, below, above or cells"
        raise case.make_error(f"{key}.{selector}", f"a mesh of {source} has no {selector}s: it {remedy}")
    try:
        if region.group is not None:
            return mesh.regions.find_group(region.group)
        return mesh.regions.find_values(region.field, region.value)
    except MeshError as error:
        raise case.make_error(f"{key}.{selector}", str(error)) from None


def _find_centers(mesh: ElementMesh) -> Floats:
    """Return the mean of the corners of every cell (e, d): the same for both orders."""
    return np.asarray(mesh.points[mesh.cells[:, : mesh.dimension + 1]].mean(axis=1))


def _find_children(case: Case, key: str, cells: tuple[int, ...], mesh: ElementMesh) -> Ints:
    """Return the cells of the mesh that are, or come from, cells of the mesh before it was refined."""
    ancestors = np.arange(len(mesh.cells)) // 2 ** (mesh.dimension * case.mesh.refine)
    count = int(ancestors[-1]) + 1
    if max(cells) >= count:
        raise case.make_error(f"{key}.cells", f"{max(cells)} is not a cell; the mesh has {count}, counted from 0")
    return np.flatnonzero(np.isin(ancestors, cells))
