"""Intel MKL's sparse Cholesky ("Pardiso"), called through its C interface: the fastest factor for large meshes here.

Optional: the `mkl` extra installs Intel's proprietary wheel on x86-64 Linux and Windows.
"""

import ctypes
from functools import cache
from importlib.metadata import PackageNotFoundError, files
from typing import Any

import numpy as np

from pipeline.arrays import Floats, Ints
from pipeline.errors import SolveError
from pipeline.fem.assembly import BlockPattern
from pipeline.linear.solver import LinearSolver, NodalRotations, SystemSettings
from pipeline.linear.superlu import SuperLU
from pipeline.linear.work import Work

_POSITIVE_DEFINITE = 2  # mtype: real, symmetric
_ANALYZE_AND_FACTOR, _FACTOR, _SOLVE, _RELEASE = 12, 22, 33, -1
_SEQUENTIAL = 1  # threading layer: one thread, the same bits every time


@cache
def load_mkl() -> Any:
    """Return MKL, on one thread, or None if it is not installed."""
    try:
        paths = [path for path in files("mkl") or () if "mkl_rt." in path.name]
        mkl = ctypes.CDLL(str(paths[0].locate()))
    except (PackageNotFoundError, IndexError, OSError):
        return None
    mkl.MKL_Set_Threading_Layer(_SEQUENTIAL)
    return mkl


class PardisoFactor:
    """The Cholesky factor of matrices of one pattern, in double or single precision; refactored in place."""

    def __init__(self, pattern: BlockPattern, dtype: type) -> None:
        self.size = pattern.nodes * pattern.dimension
        self._handle = np.zeros(64, dtype=np.int64)
        self._stored, self._indptr, self._indices = _find_upper_entries(pattern)
        self._entries: np.ndarray = np.empty(len(self._stored), dtype=dtype)
        self._options = np.zeros(64, dtype=np.int32)
        # not the default options: nested dissection, no refinement, single or double precision
        self._options[[0, 1, 27]] = 1, 2, int(dtype is np.float32)
        # the number 1, kind of matrix, phase, size, no messages, error
        self._numbers = np.array([1, _POSITIVE_DEFINITE, 0, self.size, 0, 0], dtype=np.int32)
        arrays = (self._handle, self._entries, self._indptr, self._indices, self._options, self._numbers)
        # taken now: numpy cannot give addresses while the interpreter shuts down
        self._addresses = tuple(array.ctypes.data for array in arrays)
        self._phase = _ANALYZE_AND_FACTOR

    def update(self, values: Floats) -> None:
        """Factor the matrix with these values (blocks, d, d); raises SolveError if there is no factor."""
        entries = values.reshape(-1)
        if self._entries.dtype == values.dtype:
            entries.take(self._stored, 0, self._entries, "clip")
        else:  # single precision: once per run
            self._entries[:] = entries[self._stored]
        self._call(self._phase, None, None)
        self._phase = _FACTOR

    def solve(self, b: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Write the solution of A x = b into x and return it; both are contiguous and in the factor's precision."""
        self._call(_SOLVE, b, x)
        return x

    def __del__(self) -> None:
        if self._handle.any():  # also after a failed factorization
            self._call(_RELEASE, None, None)

    def _call(self, phase: int, b: np.ndarray | None, x: np.ndarray | None) -> None:
        self._numbers[2] = phase
        handle, entries, indptr, indices, options, numbers = self._addresses
        one, kind, at_phase, size, silent, error = (numbers + 4 * i for i in range(6))
        load_mkl().pardiso(
            *map(ctypes.c_void_p, (handle, one, one, kind, at_phase, size, entries, indptr, indices, None, one)),
            *map(ctypes.c_void_p, (options, silent, _find_address(b), _find_address(x), error)),
        )
        if self._numbers[5] == -4:
            raise SolveError("the system's matrix is not positive definite")
        if self._numbers[5]:
            raise SolveError(f"MKL's Pardiso failed (error {self._numbers[5]}); try another method.linear_solver")


def _find_address(array: np.ndarray | None) -> int | None:
    """Return the address of an array; ctypes' pointer objects would leave garbage behind at every call."""
    return None if array is None else array.ctypes.data


def _find_upper_entries(pattern: BlockPattern) -> tuple[Ints, np.ndarray, np.ndarray]:
    """Return the flat entries of the values on and above the diagonal, their row pointers and columns, counted from 1.

    A stored block below the diagonal is read as its transpose above it.
    """
    d, axis = pattern.dimension, np.arange(pattern.dimension)
    column = (d * pattern.rows[:, None, None] + axis[:, None] + 0 * axis[None, :]).ravel()
    row = (d * pattern.indices[:, None, None] + 0 * axis[:, None] + axis[None, :]).ravel()
    stored = np.flatnonzero(row <= column)
    stored = stored[np.lexsort((column[stored], row[stored]))]
    counts = np.bincount(row[stored], minlength=d * pattern.nodes)
    indptr = np.concatenate([[1], 1 + np.cumsum(counts)])
    return stored, indptr.astype(np.int32), (column[stored] + 1).astype(np.int32)


class Pardiso:
    """A factor by MKL for every new matrix, which must be positive definite."""

    def __init__(self, systems: SystemSettings) -> None:
        if load_mkl() is None:
            raise SolveError(
                "method.linear_solver = 'pardiso' needs the mkl package: pip install 'corotational-pipeline[mkl]'"
            )
        self._factor = PardisoFactor(systems.pattern, np.float64)

    def update(self, values: Floats, write_rotations: NodalRotations) -> Work:
        """Factor the matrix; raises SolveError if it is not positive definite."""
        self._factor.update(values)
        return Work(factorizations=1)

    def solve(self, b: Floats, x: Floats) -> Work:
        """Write the solution by substitution into x (n, d)."""
        self._factor.solve(np.ascontiguousarray(b), x)
        return Work(solves=1)


def make_pardiso_or_superlu(systems: SystemSettings) -> LinearSolver:
    """Return MKL's direct solver, or SuperLU if MKL is not installed."""
    return SuperLU(systems) if load_mkl() is None else Pardiso(systems)
