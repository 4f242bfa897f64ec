"""The choice of a body's class: compiled if its law and its elements have kernels."""

from collections.abc import Callable

from pipeline.arrays import Floats
from pipeline.fem.body import PLAIN, Body, Formulation
from pipeline.fem.compiled_body import CompiledBody, LinearBody, find_rotation_number, load_kernels
from pipeline.fem.grouped_body import GroupedBody, GroupedLinearBody
from pipeline.fem.laws import Law, Linear
from pipeline.fem.mass import MassModel
from pipeline.fem.supports import Supports
from pipeline.mesh.element_mesh import ElementMesh


def make_body(
    mesh: ElementMesh,
    law: Law,
    supports: Supports,
    load: Floats,
    mass_model: MassModel,
    varying_load: Callable[[float], Floats] | None = None,
    formulation: Formulation = PLAIN,
) -> Body:
    """Return the fastest body for a law; a law without a kernel gets a plain Body."""
    kind = Body
    if load_kernels(mesh.order, mesh.dimension) is not None and find_rotation_number(law) is not None:
        has_groups = mesh.order == 1 and formulation.volumetric == "mean"
        kinds = (GroupedLinearBody, GroupedBody) if has_groups else (LinearBody, CompiledBody)
        kind = kinds[0] if isinstance(law, Linear) else kinds[1]
    return kind(mesh, law, supports, load, mass_model, varying_load, formulation)
