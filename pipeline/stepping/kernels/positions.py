"""Compiled work of steps on nodal vectors (n, d): one pass over memory each, nothing allocated."""

from numba import njit


@njit(cache=True, error_model="numpy", nogil=True)
def kick(f, load, dt_over_mass, x, v, dt, held, where, x_new):
    """Turn f (n, d) into the velocities v + dt/m (f + load), and x_new into x + dt times these.

    Held nodes go to the positions `where` (k, d).
    """
    for n in range(len(f)):
        for i in range(f.shape[1]):
            f[n, i] = v[n, i] + dt_over_mass[n] * (f[n, i] + load[n, i])
            x_new[n, i] = x[n, i] + dt * f[n, i]
    for k in range(len(held)):
        for i in range(f.shape[1]):
            f[held[k], i] = (where[k, i] - x[held[k], i]) / dt
            x_new[held[k], i] = where[k, i]


@njit(cache=True, error_model="numpy", nogil=True)
def are_equal(x, y):
    """Return whether the numbers of x and y (n, d) are the same; NaN equals nothing."""
    for n in range(len(x)):
        for i in range(x.shape[1]):
            if x[n, i] != y[n, i]:
                return False
    return True
