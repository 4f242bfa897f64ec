"""Writers of small files in solvers' formats: the documented layouts, byte by byte, without the readers' libraries."""

import h5py
import netCDF4
import numpy as np


def write_exodus(path, points, blocks, times, nodal, cellular=None):
    """Write an Exodus II file: blocks are (kind, nodes from 0), fields (time, node) and (time, cell) by name."""
    cellular = cellular or {}
    with netCDF4.Dataset(path, "w", format="NETCDF3_64BIT_OFFSET") as file:
        file.api_version = file.version = np.float32(8.03)
        file.floating_point_word_size, file.file_size = np.int32(8), np.int32(1)
        file.title = "a bar"
        count = sum(len(nodes) for _, nodes in blocks)
        sizes = {"len_string": 33, "len_name": 33, "four": 4, "len_line": 81, "num_dim": 3, "num_nodes": len(points),
                 "num_elem": count, "num_el_blk": len(blocks), "num_nod_var": len(nodal)}  # fmt: skip
        sizes |= {"num_elem_var": len(cellular)} if cellular else {}
        file.createDimension("time_step", None)
        for name, size in sizes.items():
            file.createDimension(name, size)
        file.createVariable("time_whole", "f8", ("time_step",))[:] = times
        for axis, name in enumerate("xyz"):
            file.createVariable(f"coord{name}", "f8", ("num_nodes",))[:] = points[:, axis]
        _write_names(file, "coor_names", "num_dim", "xyz")
        file.createVariable("eb_status", "i4", ("num_el_blk",))[:] = 1
        numbers = file.createVariable("eb_prop1", "i4", ("num_el_blk",))
        numbers.setncattr("name", "ID")
        numbers[:] = 10 * np.arange(1, len(blocks) + 1)
        _write_names(file, "eb_names", "num_el_blk", [f"block{i}" for i in range(len(blocks))])
        file.createVariable("elem_num_map", "i4", ("num_elem",))[:] = 100 + np.arange(count)
        file.createVariable("node_num_map", "i4", ("num_nodes",))[:] = 500 + np.arange(len(points))
        _write_names(file, "name_nod_var", "num_nod_var", nodal)
        if cellular:
            _write_names(file, "name_elem_var", "num_elem_var", cellular)
        for number, values in enumerate(nodal.values(), 1):
            file.createVariable(f"vals_nod_var{number}", "f8", ("time_step", "num_nodes"))[:] = values
        start = 0
        for number, (kind, nodes) in enumerate(blocks, 1):
            file.createDimension(f"num_el_in_blk{number}", len(nodes))
            file.createDimension(f"num_nod_per_el{number}", nodes.shape[1])
            dims = (f"num_el_in_blk{number}", f"num_nod_per_el{number}")
            connect = file.createVariable(f"connect{number}", "i4", dims)
            connect.elem_type = kind
            connect[:] = nodes + 1
            for field, values in enumerate(cellular.values(), 1):
                variable = file.createVariable(f"vals_elem_var{field}eb{number}", "f8", ("time_step", dims[0]))
                variable[:] = np.asarray(values)[:, start : start + len(nodes)]
            start += len(nodes)
    return path


def _write_names(file, name, dimension, names):
    table = np.zeros((len(names), 33), dtype="S1")
    for i, text in enumerate(names):
        table[i, : len(text)] = list(text)
    file.createVariable(name, "S1", (dimension, "len_string"))[:] = table


def write_d3plot(folder, points, hexahedra, positions, times):
    """Write LS-DYNA's d3plot and d3plot01 in single precision: a geometry, its states, two parts of solids."""
    n, e = len(points), len(hexahedra)
    words = np.zeros(64, dtype="<i4")
    words[11] = 1  # d3plot
    words[14:15] = np.array([971.0], dtype="<f4").view("<i4")
    words[15:18] = 4, n, 6  # dimensions (4: three, connectivity not packed), nodes, LS-DYNA3D
    words[18], words[20] = 13, 1  # global values; coordinates are there
    words[23], words[24], words[27] = e, 2, 7
    numbers = [-1, n, *[0] * 13, 2, *range(1, n + 1), *range(1, e + 1), 1, 2, 1, 2, 1, 2]
    words[39], words[51] = len(numbers), 2
    materials = 1 + (np.arange(e) >= e // 2)
    solids = np.concatenate([hexahedra + 1, materials[:, None]], axis=1)
    geometry = [words, points.astype("<f4"), solids.astype("<i4"), np.array(numbers, dtype="<i4")]
    (folder / "d3plot").write_bytes(b"".join(part.tobytes() for part in geometry))
    rest = np.zeros(7 * e)
    states = [np.concatenate([[t], np.zeros(13), np.ravel(x), rest]) for t, x in zip(times, positions, strict=True)]
    (folder / "d3plot01").write_bytes(np.concatenate([*states, [-999999.0]]).astype("<f4").tobytes())
    return folder / "d3plot"


def write_cgns(path, points, tetrahedra, times, fields):
    """Write CGNS in HDF5: one zone of tetrahedra, and a solution at the vertices for each time."""
    with h5py.File(path, "w", track_order=True) as file:
        _set_node(file, "HDF5 MotherNode", "Root Node of HDF5 File")
        file.create_dataset(" format", data=np.frombuffer(b"IEEE_LITTLE_32\0", dtype="i1"))
        file.create_dataset(" hdf5version", data=np.frombuffer(b"HDF5 Version 1.14.0".ljust(33, b"\0"), dtype="i1"))
        _add_node(file, "CGNSLibraryVersion", "CGNSLibraryVersion_t", np.array([3.3], dtype="f4"))
        base = _add_node(file, "Base", "CGNSBase_t", np.array([3, 3], dtype="i4"))
        steps = _add_node(base, "BaseIterativeData", "BaseIterativeData_t", np.array([len(times)], dtype="i4"))
        _add_node(steps, "TimeValues", "DataArray_t", np.array(times, dtype="f8"))
        sizes = np.array([[len(points)], [len(tetrahedra)], [0]], dtype="i4")
        zone = _add_node(base, "Zone", "Zone_t", sizes)
        _add_node(zone, "ZoneType", "ZoneType_t", "Unstructured")
        grid = _add_node(zone, "GridCoordinates", "GridCoordinates_t")
        for axis, name in enumerate("XYZ"):
            _add_node(grid, f"Coordinate{name}", "DataArray_t", np.array(points[:, axis], dtype="f8"))
        cells = _add_node(zone, "Cells", "Elements_t", np.array([10, 0], dtype="i4"))  # four-node tetrahedra
        _add_node(cells, "ElementRange", "IndexRange_t", np.array([1, len(tetrahedra)], dtype="i4"))
        _add_node(cells, "ElementConnectivity", "DataArray_t", (tetrahedra + 1).astype("i4").ravel())
        names = [f"Solution{k}" for k in range(len(times))]
        for k, name in enumerate(names):
            solution = _add_node(zone, name, "FlowSolution_t")
            _add_node(solution, "GridLocation", "GridLocation_t", "Vertex")
            for field, values in fields.items():
                for axis, letter in enumerate("XYZ"):
                    column = np.array(np.asarray(values)[k][:, axis], dtype="f8")
                    _add_node(solution, f"{field}{letter}", "DataArray_t", column)
        pointers = _add_node(zone, "ZoneIterativeData", "ZoneIterativeData_t")
        text = np.frombuffer("".join(name.ljust(32) for name in names).encode(), dtype="i1").reshape(-1, 32)
        _add_node(pointers, "FlowSolutionPointers", "DataArray_t", text, "C1")
    return path


def _set_node(group, name, label, kind="MT"):
    for key, text, size in (("name", name, 33), ("label", label, 33), ("type", kind, 3)):
        string = h5py.h5t.C_S1.copy()
        string.set_size(size)
        space = h5py.h5s.create(h5py.h5s.SCALAR)
        attribute = h5py.h5a.create(group.id, key.encode(), string, space)
        attribute.write(np.array(text.encode(), dtype=f"S{size}"))
    if name != "HDF5 MotherNode":
        group.attrs.create("flags", np.array([1], dtype="i4"))


def _add_node(parent, name, label, data=None, kind=""):
    group = parent.create_group(name, track_order=True)
    if isinstance(data, str):
        data, kind = np.frombuffer(data.encode(), dtype="i1"), "C1"
    kinds = {"i4": "I4", "i8": "I8", "f4": "R4", "f8": "R8"}
    _set_node(group, name, label, "MT" if data is None else kind or kinds[data.dtype.str[1:]])
    if data is not None:
        group.create_dataset(" data", data=data)
    return group


def write_ensight(folder, points, blocks, times, fields):
    """Write EnSight Gold in text: each block is a part (kind, points used, nodes from 0); fields (time, node, 3)."""
    case = ["FORMAT", "type: ensight gold", "GEOMETRY", "model: bar.geo", "VARIABLE"]
    case += [f"vector per node: 1 {name} {name}.****" for name in fields]
    case += [
        "TIME",
        "time set: 1",
        f"number of steps: {len(times)}",
        "filename start number: 0",
        "filename increment: 1",
    ]
    (folder / "bar.case").write_text("\n".join([*case, "time values: " + " ".join(map(str, times)), ""]))
    lines = ["a bar", "of two parts", "node id assign", "element id assign"]
    for number, (kind, used, nodes) in enumerate(blocks, 1):
        lines += ["part", f"{number:10d}", f"block{number}", "coordinates", f"{len(used):10d}"]
        lines += [f"{value:12.5e}" for value in points[used].T.ravel()]
        lines += [kind, f"{len(nodes):10d}"]
        lines += ["".join(f"{node:10d}" for node in row) for row in np.searchsorted(used, nodes) + 1]
    (folder / "bar.geo").write_text("\n".join([*lines, ""]))
    for name, values in fields.items():
        for k in range(len(times)):
            lines = [name]
            for number, (_, used, _nodes) in enumerate(blocks, 1):
                lines += ["part", f"{number:10d}", "coordinates"]
                lines += [f"{value:12.5e}" for value in np.asarray(values[k])[used].T.ravel()]
            (folder / f"{name}.{k:04d}").write_text("\n".join([*lines, ""]))
    return folder / "bar.case"


def write_openfoam(folder, points, faces, owners, neighbors, displacements):
    """Write an OpenFOAM case: faces of inner cells first; point displacements by time."""
    mesh = folder / "constant" / "polyMesh"
    mesh.mkdir(parents=True)

    def write(path, kind, body):
        name = path.name
        head = f"FoamFile\n{{ version 2.0; format ascii; class {kind}; object {name}; }}\n"
        path.parent.mkdir(exist_ok=True)
        path.write_text(head + body)

    def list_values(values):
        return f"{len(values)}\n(\n" + "\n".join(values) + "\n)\n"

    vectors = [f"({x!r} {y!r} {z!r})" for x, y, z in np.asarray(points).tolist()]
    write(mesh / "points", "vectorField", list_values(vectors))
    texts = [f"{len(face)}({' '.join(map(str, face))})" for face in faces]
    write(mesh / "faces", "faceList", list_values(texts))
    write(mesh / "owner", "labelList", list_values([str(cell) for cell in owners]))
    write(mesh / "neighbour", "labelList", list_values([str(cell) for cell in neighbors]))
    inner = len(neighbors)
    patch = f"walls {{ type wall; nFaces {len(faces) - inner}; startFace {inner}; }}"
    write(mesh / "boundary", "polyBoundaryMesh", f"1\n(\n{patch}\n)\n")
    control = "application none; startTime 0; endTime 1; deltaT 1; writeControl timeStep; writeInterval 1;\n"
    write(folder / "system" / "controlDict", "dictionary", control)
    for time, values in displacements.items():
        vectors = [f"({x!r} {y!r} {z!r})" for x, y, z in np.asarray(values).tolist()]
        body = f"dimensions [0 1 0 0 0 0 0];\ninternalField nonuniform List<vector>\n{list_values(vectors)};\n"
        write(
            folder / time / "pointDisplacement",
            "pointVectorField",
            body + "boundaryField { walls { type calculated; } }\n",
        )
    (folder / "bar.foam").write_text("")
    return folder / "bar.foam"
