"""The environment variables from which libraries read their number of threads, once, when they are loaded."""

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def make_thread_environment(count: int) -> dict[str, str]:
    """Return the variables that make a process started with them use this many threads."""
    return dict.fromkeys(THREAD_VARIABLES, str(count))
