SetFactory("OpenCASCADE");
Disk(1) = {0, 0, 0, 1, 1};
Mesh.MeshSizeMin = 0.7; Mesh.MeshSizeMax = 0.7; Mesh.ElementOrder = 2; Mesh.SaveAll = 1;
