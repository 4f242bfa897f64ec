"""VTK's numbers for cell types, and how many corners each type has.

https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html; the numbers are those of vtkCellType.h.
"""

TRIANGLE, TETRAHEDRON = 5, 10
CELL_TYPES = {2: TRIANGLE, 3: TETRAHEDRON}  # the simplex of each dimension
# types with a fixed number of corners
CORNERS = {
    1: 1,  # vertex
    3: 2,  # line
    TRIANGLE: 3,
    9: 4,  # quadrilateral
    TETRAHEDRON: 4,
    12: 8,  # hexahedron
    13: 6,  # wedge
    14: 5,  # pyramid
    21: 3,  # quadratic edge
    22: 6,  # quadratic triangle
    23: 8,  # quadratic quadrilateral
    24: 10,  # quadratic tetrahedron
    25: 20,  # quadratic hexahedron
}
