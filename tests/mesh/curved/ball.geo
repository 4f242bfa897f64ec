SetFactory("OpenCASCADE");
Sphere(1) = {0, 0, 0, 1};
Mesh.MeshSizeMin = 0.9; Mesh.MeshSizeMax = 0.9; Mesh.ElementOrder = 2; Mesh.SaveAll = 1;
