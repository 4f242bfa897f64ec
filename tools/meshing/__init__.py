"""How cases/meshes/*.vtu were made; nothing here runs in the pipeline or in its quick tests."""
