"""Meshes of cases as plain arrays: readers of our own, meshio's, and those of series."""
