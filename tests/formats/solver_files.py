"""Writers of small files in solvers' formats: the documented layouts, byte by byte, without the readers' libraries."""

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
