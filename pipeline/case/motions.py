"""The keys of supports, of their motions, and of the initial motion."""

from typing import Annotated

from pydantic import model_validator

from pipeline.case.python_values import PythonValue
from pipeline.case.selectors import SelectorSpec
from pipeline.case.spec import Spec, about
from pipeline.case.values import AxisNames, Direction, FiniteNumber, Vector, make_fault


class SpinSpec(Spec):
    """A rotation about an axis."""

    axis: Annotated[Direction, about("direction of the axis; along z for a planar mesh")]
    rate: Annotated[FiniteNumber, about("angular velocity", "degree/s")]
    center: Annotated[Vector | None, about("a point on the axis; the center of mass for a free body", "m")] = None


class MotionSpec(Spec):
    """The motion of supported nodes: a velocity, a spin, or both; or a function from Python."""

    velocity: Annotated[Vector | None, about("velocity of the nodes", "m/s")] = None
    spin: Annotated[SpinSpec | None, about("rotation of the nodes about an axis; needs a center")] = None
    displacement: Annotated[
        PythonValue | None, about("displacement as a function of X and t, given in Python", "m")
    ] = None

    @model_validator(mode="after")
    def _check_motion(self) -> "MotionSpec":
        rigid = self.velocity is not None or self.spin is not None
        if not rigid and self.displacement is None:
            raise make_fault("neither velocity nor spin is given")
        if rigid and self.displacement is not None:
            raise make_fault("cannot be combined with velocity or spin", "displacement")
        return self


class SupportSpec(SelectorSpec):
    """Nodes that are held, or moved, along all axes or only some."""

    motion: Annotated[MotionSpec | None, about("how the nodes move; without it they stay at rest")] = None
    components: Annotated[AxisNames | None, about("axes along which the nodes are held; all if not given")] = None


class InitialSpec(Spec):
    """The initial motion; the body starts at its rest positions."""

    velocity: Annotated[Vector | None, about("initial velocity of the free nodes", "m/s")] = None
    spin: Annotated[SpinSpec | None, about("initial rotation, added to the velocity")] = None
    factor: Annotated[FiniteNumber, about("factor by which velocity and spin are multiplied")] = 1.0
    velocity_field: Annotated[
        PythonValue | None,
        about("initial velocity of every node, an array from Python; cannot be combined with velocity", "m/s"),
    ] = None

    @model_validator(mode="after")
    def _check_velocity(self) -> "InitialSpec":
        if self.velocity is not None and self.velocity_field is not None:
            raise make_fault("velocity and velocity_field cannot be combined")
        return self
