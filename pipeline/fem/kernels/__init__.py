"""Compiled twins of the equations in fem/, one file each; importing one of them imports numba."""

POLAR, GRAM_SCHMIDT, IDENTITY = 0, 1, 2  # the numbers by which kernels know rotations
