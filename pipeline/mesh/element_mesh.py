"""The interface of the meshes that can be solved: simplices of order 1 and 2."""

from typing import Protocol

from pipeline.arrays import Floats, Ints
from pipeline.mesh.body_mesh import BodyMesh
from pipeline.mesh.integration import Integration
from pipeline.mesh.regions import Regions


class ElementMesh(BodyMesh, Protocol):
    """A body mesh of e elements of one kind with k nodes each, in VTK's order: the d + 1 corners first."""

    @property
    def cells(self) -> Ints:
        """Return the nodes of every element (e, k)."""
        ...

    @property
    def regions(self) -> Regions | None:
        """Return the groups and fields of the file that the mesh comes from; None for other meshes."""
        ...

    @property
    def order(self) -> int:
        """Return the degree of the shape functions, 1 or 2."""
        ...

    @property
    def integration(self) -> Integration:
        """Return the q points per element at which stresses are integrated: weights and gradients."""
        ...

    @property
    def shape_products(self) -> Floats:
        """Return int N_a N_b dV of every element (e, k, k) [m3; m2 in the plane]."""
        ...

    @property
    def lumped_shares(self) -> Floats:
        """Return the positive share of every node in the volume of its element (e, k)."""
        ...

    @property
    def lumped_volumes(self) -> Floats:
        """Return the sums of these shares at the nodes (n,)."""
        ...
