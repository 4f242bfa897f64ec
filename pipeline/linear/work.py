"""Counts of the work that a step took, and its seconds."""

from dataclasses import dataclass


@dataclass(slots=True)  # not frozen: that makes it five times slower to make, several times a step
class Work:
    """What was done: counts that machines share, and the seconds that they do not.

    Who is returned one may count on in it.

    `iterations` counts the linear systems' right-hand sides posed (Newton iterations), `solves` the systems solved for
    them, `linear_iterations` what iterative solvers took for it; `seconds` is solving alone, without measuring or
    writing.
    """

    steps: int = 0
    solves: int = 0
    iterations: int = 0
    factorizations: int = 0
    linear_iterations: int = 0
    rotations: int = 0
    seconds: float = 0.0

    def __add__(self, other: "Work") -> "Work":
        # written out: it is called several times a step, and small bodies take a tenth of a millisecond a step
        return Work(
            self.steps + other.steps,
            self.solves + other.solves,
            self.iterations + other.iterations,
            self.factorizations + other.factorizations,
            self.linear_iterations + other.linear_iterations,
            self.rotations + other.rotations,
            self.seconds + other.seconds,
        )
