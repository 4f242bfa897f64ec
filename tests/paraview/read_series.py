"""Run by pvbatch: prints the series as ParaView reads it, as JSON on the last line."""

import json
import sys

from paraview import servermanager, simple
from vtkmodules.util.numpy_support import vtk_to_numpy

reader = simple.PVDReader(FileName=sys.argv[1])
reader.UpdatePipeline()
times = list(reader.TimestepValues)
content = {"version": str(simple.GetParaViewVersion()), "times": times, "frames": []}
for time in times:
    reader.UpdatePipeline(time)
    grid = servermanager.Fetch(reader)
    if grid.IsA("vtkMultiBlockDataSet"):
        grid = grid.GetBlock(0)
    frame = {"points": vtk_to_numpy(grid.GetPoints().GetData()).tolist(), "cells": grid.GetNumberOfCells()}
    for kind, data in (("point", grid.GetPointData()), ("cell", grid.GetCellData()), ("field", grid.GetFieldData())):
        for i in range(data.GetNumberOfArrays()):
            array = data.GetArray(i)
            lengths = [array.GetNumberOfComponents(), array.GetNumberOfTuples()]
            frame[kind + " " + array.GetName()] = [*lengths, array.GetDataTypeAsString(), *array.GetRange(0)]
    content["frames"].append(frame)
print(json.dumps(content))
