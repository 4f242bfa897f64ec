"""The keys that choose nodes of the rest mesh."""

from typing import Annotated, ClassVar

from pydantic import AfterValidator, model_validator

from pipeline.case.spec import Spec, about
from pipeline.case.values import AxisName, FiniteNumber, Length, NodeNumbers, Positive, Vector, make_fault
from pipeline.errors import quote_value


class SphereSpec(Spec):
    """A ball."""

    center: Annotated[Vector, about("center of the ball", "m")]
    radius: Annotated[Positive, about("radius of the ball", "m")]


class HalfSpaceSpec(Spec):
    """Everything on one side of a plane."""

    axis: Annotated[AxisName, about("axis that the plane is perpendicular to")]
    at: Annotated[FiniteNumber, about("position of the plane along the axis", "m")]


def _check_box(corners: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
    low, high = corners
    if len(low) != len(high):
        raise make_fault(f"corners have {len(low)} and {len(high)} entries")
    if any(a > b for a, b in zip(low, high, strict=True)):
        raise make_fault(
            f"{quote_value(list(low))} is not below {quote_value(list(high))}; write [[lowest], [highest]]"
        )
    return corners


Box = Annotated[tuple[Vector, ...], Length(2, 2), AfterValidator(_check_box)]


class SelectorSpec(Spec):
    """A set of nodes, chosen by exactly one of plane (with at), box, sphere, below, above or nodes."""

    kinds: ClassVar[tuple[str, ...]] = ("plane", "box", "sphere", "below", "above", "nodes")

    plane: Annotated[AxisName | None, about("nodes in the plane perpendicular to this axis; requires the key at")] = (
        None
    )
    at: Annotated[FiniteNumber | None, about("position of the plane along its axis, after scaling", "m")] = None
    box: Annotated[Box | None, about("nodes in a box, given as [[lowest corner], [highest corner]]", "m")] = None
    sphere: Annotated[SphereSpec | None, about("nodes in a ball")] = None
    below: Annotated[HalfSpaceSpec | None, about("nodes below a plane")] = None
    above: Annotated[HalfSpaceSpec | None, about("nodes above a plane")] = None
    nodes: Annotated[NodeNumbers | None, about("node numbers, counted from 0")] = None

    @model_validator(mode="after")
    def _check_selector(self) -> "SelectorSpec":
        chosen = self.list_chosen()
        if self.at is not None and not chosen:
            raise make_fault("needs plane, which is not given", "at")
        if not chosen:
            raise make_fault(f"no selector; give one of {', '.join(self.kinds)}")
        if len(chosen) > 1:
            raise make_fault(f"{chosen[0]} and {chosen[1]} cannot be combined")
        if "at" not in chosen and (self.plane is None) != (self.at is None):
            raise make_fault("missing" if self.at is None else "needs plane, which is not given", "at")
        return self

    def list_chosen(self) -> list[str]:
        """Return the keys that choose nodes."""
        return [kind for kind in self.kinds if kind != "at" and getattr(self, kind) is not None]
