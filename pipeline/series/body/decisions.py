"""The decisions about a series, as short texts: what its points, displacement, rest state, cells and times are."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Decisions:
    """Texts for the answer of `pipeline analyze` and for attributes; `left_out` is empty if all cells are measured.

    `points` says where the deformed positions come from, `rest` the rest state, `cells` the measured cells by kind,
    `times` the instants, `left_out` the cells that are not measured and their share of the volume.
    """

    points: str
    rest: str
    cells: str
    times: str = ""
    left_out: str = ""

    def __str__(self) -> str:
        """Return two lines: positions and rest state; cells and times."""
        return (
            f"points: {self.points}; rest state: {self.rest}\n"
            f"cells: {self.cells}; left out: {self.left_out or 'nothing'}; times: {self.times}"
        )
