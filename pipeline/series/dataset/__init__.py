"""A series as an xarray dataset: its fields over all frames, its mesh as variables, and frames written from it."""
