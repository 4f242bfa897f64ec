"""Counts of the work of a step, and its solving time."""

from dataclasses import dataclass


@dataclass(slots=True)  # not frozen: construction, several times a step, would take five times as long
class Work:
    """Counts, which are the same on every machine, and seconds. The caller owns a returned object and may add to it.

    `iterations` counts right-hand sides (Newton iterations), `solves` the systems solved for them, `linear_iterations`
    the iterations of iterative linear solvers; `seconds` is solving time, without measuring or writing.
    """

    steps: int = 0
    solves: int = 0
    iterations: int = 0
    factorizations: int = 0
    linear_iterations: int = 0
    rotations: int = 0
    seconds: float = 0.0

    def __add__(self, other: "Work") -> "Work":
        # written out: this is called several times a step, and a step of a small body takes a tenth of a millisecond
        return Work(
            self.steps + other.steps,
            self.solves + other.solves,
            self.iterations + other.iterations,
            self.factorizations + other.factorizations,
            self.linear_iterations + other.linear_iterations,
            self.rotations + other.rotations,
            self.seconds + other.seconds,
        )
