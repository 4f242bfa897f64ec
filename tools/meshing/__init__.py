"""The program that made cases/meshes/*.vtu; the package does not use it."""
