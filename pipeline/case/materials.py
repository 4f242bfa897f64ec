"""The material of a case, and the materials of regions."""

from typing import Annotated

from pydantic import model_validator

from pipeline.case.selectors import Box, HalfSpaceSpec, SphereSpec
from pipeline.case.spec import Spec, about
from pipeline.case.values import Integer, NodeNumbers, NotNegative, PoissonRatio, Positive, Text, make_fault

_SELECTORS = ("group", "field", "box", "sphere", "below", "above", "cells")


class ElasticSpec(Spec):
    """An isotropic and linear material."""

    youngs_modulus: Annotated[Positive, about("Young's modulus", "Pa")]
    poisson_ratio: Annotated[PoissonRatio, about("Poisson's ratio, above -1 and below 0.5")]
    density: Annotated[Positive, about("mass per rest volume", "kg/m3")]


class MaterialSpec(ElasticSpec):
    """The material: isotropic and linear."""

    mass_damping: Annotated[NotNegative, about("alpha of C = alpha M + beta K', damps slow motions", "1/s")] = 0.0
    stiffness_damping: Annotated[NotNegative, about("beta of C = alpha M + beta K', damps fast vibrations", "s")] = 0.0


class RegionSpec(ElasticSpec):
    """The material of a region: cells chosen by exactly one of group, field (with value), box, sphere, below, above
    or cells.
    """

    group: Annotated[Text | None, about("cells of a group of the mesh file, by its name or number")] = None
    field: Annotated[Text | None, about("cells by a field of the mesh file; requires the key value")] = None
    value: Annotated[Integer | None, about("value of that field in the cells, a whole number")] = None
    box: Annotated[Box | None, about("cells with centers in a box, [[lowest corner], [highest corner]]", "m")] = None
    sphere: Annotated[SphereSpec | None, about("cells with centers in a ball")] = None
    below: Annotated[HalfSpaceSpec | None, about("cells with centers below a plane")] = None
    above: Annotated[HalfSpaceSpec | None, about("cells with centers above a plane")] = None
    cells: Annotated[NodeNumbers | None, about("cell numbers of the mesh before mesh.refine, counted from 0")] = None

    @model_validator(mode="after")
    def _check_region(self) -> "RegionSpec":
        chosen = [kind for kind in _SELECTORS if getattr(self, kind) is not None]
        if not chosen:
            raise make_fault(f"no selector; give one of {', '.join(_SELECTORS)}")
        if len(chosen) > 1:
            raise make_fault(f"{chosen[0]} and {chosen[1]} cannot be combined")
        if (self.field is None) != (self.value is None):
            raise make_fault("missing" if self.value is None else "needs field, which is not given", "value")
        return self
