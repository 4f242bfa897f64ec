"""The numbers of one frame, and the table of every variable in files and datasets.

Pure functions: sinks use them to measure the frames of a run, and an analysis those of any other series.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pipeline.arrays import Floats
from pipeline.fem.element import deformation_gradient
from pipeline.fem.rotation import angle, polar
from pipeline.mesh.body_mesh import BodyMesh
from pipeline.mesh.cell_mesh import require_cell_mesh
from pipeline.mesh.simplex import Mesh, signed_volumes
from pipeline.run.frame import Frame, Values

MATERIAL = "material"  # cell field of bodies of several materials: their number
QUANTILES = (0.0, 0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99, 1.0)


@dataclass(frozen=True)
class Variable:
    """The meaning of a name: dimensions in one frame, unit, a short name for axes and tables, and a longer comment."""

    dims: tuple[str, ...]
    units: str
    long_name: str
    comment: str = ""


_RUNGS = "0 linear, 1 corotational, 2 converged"
VARIABLES: Mapping[str, Variable] = {
    "volume_ratio": Variable(("cell",), "1", "volume over rest volume, det F", "negative for inverted cells"),
    "volume_ratio_min": Variable(("cell",), "1", "smallest det F in the cell", "of quadrature points and nodes"),
    "volume_ratio_max": Variable(("cell",), "1", "largest det F in the cell", "of quadrature points and nodes"),
    "rotation_angle": Variable(("cell",), "degree", "angle of the polar rotation of the deformation gradient"),
    "total_volume": Variable((), "m3", "signed sum of the volumes of all cells"),
    "volume_drift": Variable((), "1", "total volume over total rest volume, minus one"),
    "volume_ratio_mean": Variable((), "1", "mean volume ratio, weighted by rest volume"),
    "volume_ratio_quantile": Variable(("quantile",), "1", "quantiles of the volume ratio over cells, unweighted"),
    "inverted_count": Variable((), "1", "number of inverted cells", "det F is zero or less somewhere in them"),
    "center_of_mass": Variable(("axis",), "m", "center of mass", "by the densities of a run, else of a uniform body"),
    "kinetic_energy": Variable((), "J", "kinetic energy"),
    "elastic_energy": Variable((), "J", "elastic energy", "of the law that was solved"),
    "potential_energy": Variable((), "J", "potential energy of the dead loads", "zero at the rest positions"),
    "linear_momentum": Variable(("axis",), "kg m s-1", "linear momentum"),
    "angular_momentum": Variable(("axis",), "kg m2 s-1", "angular momentum about the origin"),
    "newton_iterations": Variable((), "1", "linear systems solved since the previous frame"),
    "rung": Variable((), "1", "highest model of the steps since the previous frame", _RUNGS),
    "indicator": Variable((), "1", "bound on spurious volume in steps since the previous frame"),
}
# numbers of each step since the previous frame, if the method chooses a model for each step
STEPS: Mapping[str, Variable] = {
    "step_rung": Variable(("step",), "1", "model that the step needed", _RUNGS),
    "step_solves": Variable(("step",), "1", "linear systems solved in the step"),
    "step_indicator": Variable(("step",), "1", "bound on the spurious volume of the step"),
}
# values that are the same in every frame, and the coordinates
FIXED: Mapping[str, Variable] = {
    "time": Variable((), "s", "time since the start"),
    "rest_volume": Variable(("cell",), "m3", "rest volume of the cell"),
    "quantile": Variable(("quantile",), "1", "quantile of cells"),
    "axis": Variable(("axis",), "1", "axis of space"),
    "step": Variable((), "1", "number of the time step", "counted from 1"),
}
_TABLES = {**VARIABLES, **STEPS, **FIXED}
AXES = ("x", "y", "z")
# in the plane a volume is an area and an energy is per meter of thickness
_PLANAR_UNITS = {"m3": "m2", "J": "J m-1", "kg m s-1": "kg s-1", "kg m2 s-1": "kg m s-1"}


def get_units(name: str, dimension: int) -> str:
    """Return the unit of a variable for a body of that dimension; a planar one has unit thickness."""
    unit = _TABLES[name].units
    return _PLANAR_UNITS.get(unit, unit) if dimension == 2 else unit


def make_attributes(name: str, dimension: int) -> dict[str, str]:
    """Return the CF attributes of a variable or coordinate for a body of that dimension."""
    variable = _TABLES[name]
    comment = {"comment": variable.comment} if variable.comment else {}
    return {"units": get_units(name, dimension), "long_name": variable.long_name, **comment}


def pad_to_space(vector: Floats) -> Floats:
    """Return vectors (..., d) with three components, as files store them: zero along z in the plane."""
    missing = 3 - vector.shape[-1]
    return np.pad(vector, [(0, 0)] * (vector.ndim - 1) + [(0, missing)])


class CellMeasures(NamedTuple):
    """Measures of every cell (e,): signed volume, extremes of det F in it, angle of its polar rotation [rad]."""

    volumes: Floats
    ratio_min: Floats
    ratio_max: Floats
    angles: Floats


def measure_cells(mesh: BodyMesh, x: Floats) -> CellMeasures:
    """Return the measures of each cell at positions x (n, d)."""
    if not isinstance(mesh, Mesh):
        from pipeline.run.cell_measures import measure_any_cells

        return CellMeasures(*measure_any_cells(require_cell_mesh(mesh), x))
    if mesh.dimension == 2:
        return measure_simplices_by_numpy(mesh, x)
    from pipeline.fem.kernels import volumes_and_angles as measure_kernels

    volumes, angles = np.empty((2, len(mesh.cells)))
    x = np.ascontiguousarray(x, dtype=np.float64)
    measure_kernels.measure_cells(x, mesh.cells, mesh.shape_gradients, volumes, angles)
    angles[np.isnan(volumes)] = np.nan  # a node is missing; the rotation of such a cell is not zero but unknown
    ratio = volumes / mesh.rest_volumes
    return CellMeasures(volumes, ratio, ratio, angles)


def measure_simplices_by_numpy(mesh: Mesh, x: Floats) -> CellMeasures:
    """Return the same as `measure_cells`: the reference for the compiled kernel, also used for triangles."""
    volumes = signed_volumes(x, mesh.cells)
    ratio = volumes / mesh.rest_volumes
    return CellMeasures(volumes, ratio, ratio, angle(polar(deformation_gradient(mesh, x))))


def measure(frame: Frame) -> Values:
    """Return the values of all variables that this frame has, by the names in VARIABLES and STEPS."""
    mesh = frame.mesh
    cells = measure_cells(mesh, frame.x)
    ratio = cells.volumes / mesh.rest_volumes
    total, rest = cells.volumes.sum(), mesh.rest_volumes.sum()
    extremes: Values = {}
    if not isinstance(mesh, Mesh):  # in linear simplices det F is the same everywhere
        extremes = {"volume_ratio_min": cells.ratio_min, "volume_ratio_max": cells.ratio_max}
    return {
        **frame.known,
        "volume_ratio": ratio,
        **extremes,
        "rotation_angle": np.degrees(cells.angles),
        "total_volume": np.asarray(total),
        "volume_drift": np.asarray(total / rest - 1),
        "volume_ratio_mean": np.asarray((ratio * mesh.rest_volumes).sum() / rest),
        "volume_ratio_quantile": np.quantile(ratio, QUANTILES),
        # unknown if a cell has no numbers: a count of the others would look like good news
        "inverted_count": np.asarray(np.nan if np.isnan(total) else float((cells.ratio_min <= 0).sum())),
        "center_of_mass": frame.known.get("center_of_mass", pad_to_space(mesh.node_volumes @ frame.x / rest)),
        **frame.whole,
    }
