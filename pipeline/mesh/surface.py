"""The boundary of a simplex mesh: the faces that belong to one cell only."""

import numpy as np

from pipeline.mesh.simplex import Floats, Ints, Mesh

# the face opposite vertex a, ordered so that its normal points out of a positively oriented cell
_OUTWARD = {2: np.array([[1, 2], [2, 0], [0, 1]]), 3: np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])}


def boundary_faces(mesh: Mesh) -> tuple[Ints, Ints]:
    """Return the boundary faces (f, d), outward oriented, and the cell that each belongs to (f,)."""
    d = mesh.dimension
    faces = mesh.cells[:, _OUTWARD[d]].reshape(-1, d)
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    chosen = np.sort(first[count == 1])
    return faces[chosen], chosen // (d + 1)


def outward_areas(points: Floats, faces: Ints) -> Floats:
    """Return n A of every face (f, d): its outward normal times its area [m2; m in the plane]."""
    corners = points[faces]
    side = corners[:, 1] - corners[:, 0]
    if faces.shape[1] == 2:
        return np.stack([side[:, 1], -side[:, 0]], axis=-1)
    return np.asarray(np.cross(side, corners[:, 2] - corners[:, 0]) / 2)
