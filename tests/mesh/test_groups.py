"""Groups of simplices that share one dilatation: blocks of structured meshes, at least d! neighbors elsewhere."""

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from pipeline.case import load_case
from pipeline.mesh.files import read_mesh
from pipeline.mesh.groups import find_groups
from pipeline.mesh.node_order import SIMPLEX_EDGES
from pipeline.mesh.shapes import box, rectangle
from pipeline.mesh.simplex import Mesh


def find_plain_groups(mesh: Mesh) -> np.ndarray:
    return find_groups(mesh, np.zeros(len(mesh.cells)))


def read_case_mesh(name: str) -> Mesh:
    case = load_case(f"cases/{name}.toml")
    return read_mesh(case.mesh_path, scale=case.mesh.scale)


@pytest.mark.parametrize("split", ["kuhn", "alternating"])
@pytest.mark.parametrize(("shape", "counts"), [(box, (2, 3, 2)), (rectangle, (2, 3))])
def test_blocks_of_structured_meshes_are_groups(shape, counts, split):
    mesh = shape((1.0, 3.0, 2.0)[: len(counts)], counts, split)
    block = np.arange(len(mesh.cells)) // (6 if mesh.dimension == 3 else 2)
    assert len(np.unique(np.stack([find_plain_groups(mesh), block]), axis=1).T) == block[-1] + 1


@pytest.mark.parametrize("name", ["mushroom", "armadillo"])
def test_groups_of_other_meshes_are_connected_and_large_enough(name):
    mesh = read_case_mesh(name)
    labels = find_plain_groups(mesh)
    sizes = np.bincount(labels)
    assert sizes.min() >= 6 and sizes.max() <= 16 and len(sizes) < len(mesh.points) / 2
    for group in range(len(sizes)):
        cells = mesh.cells[labels == group]
        sides = np.sort(cells[:, SIMPLEX_EDGES[3]], axis=2) @ [len(mesh.points), 1]
        _, side = np.unique(sides, return_inverse=True)
        owner = np.repeat(np.arange(len(cells)), 6)
        graph = coo_array((np.ones(side.size), (owner, len(cells) + side.ravel())), shape=(7 * len(cells),) * 2)
        component = connected_components(graph, directed=False)[1][: len(cells)]
        assert (component == component[0]).all()


def test_groups_do_not_cross_materials_and_are_the_same_every_time():
    mesh = read_case_mesh("mushroom")
    kinds = (mesh.centers[:, 2] > 0).astype(float)
    labels = find_groups(mesh, kinds)
    assert len(np.unique(np.stack([labels, kinds]), axis=1).T) == labels.max() + 1
    assert (find_groups(mesh, kinds) == labels).all()


def test_a_cell_alone_is_a_group():
    X = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    mesh = Mesh(np.concatenate([X, X + 5]), np.array([[0, 1, 2, 3], [4, 5, 6, 7]]))
    assert find_plain_groups(mesh).tolist() == [0, 1]
