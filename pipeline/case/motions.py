"""The keys of supports, of their motions, and of the initial motion."""

from typing import Annotated

from pydantic import model_validator

from pipeline.case.python_values import PythonValue, VectorOrPython
from pipeline.case.selectors import SelectorSpec
from pipeline.case.spec import Spec, about
from pipeline.case.values import AxisNames, Direction, FiniteNumber, Positive, TimeFactor, Vector, make_fault


class SpinSpec(Spec):
    """A rotation about an axis."""

    axis: Annotated[Direction, about("direction of the axis; along z for a planar mesh")]
    rate: Annotated[FiniteNumber, about("angular velocity", "degree/s")]
    center: Annotated[Vector | None, about("a point on the axis; the center of mass for a free body", "m")] = None


class MotionSpec(Spec):
    """The motion of supported nodes: a velocity, a spin, or both; or a displacement with a history, or from Python."""

    velocity: Annotated[Vector | None, about("velocity of the nodes", "m/s")] = None
    spin: Annotated[SpinSpec | None, about("rotation of the nodes about an axis; needs a center")] = None
    displacement: Annotated[
        VectorOrPython | None, about("displacement of the nodes, multiplied by the history, which starts at 0", "m")
    ] = None
    history: Annotated[
        TimeFactor | None,
        about("factor of velocity and spin, or of displacement, as a function of t: an expression, or a table"),
    ] = None
    until: Annotated[Positive | None, about("time at which the motion ends; the nodes stay there", "s")] = None

    @model_validator(mode="after")
    def _check_motion(self) -> "MotionSpec":
        rigid = self.velocity is not None or self.spin is not None
        if not rigid and self.displacement is None:
            raise make_fault("none of velocity, spin and displacement is given")
        if rigid and self.displacement is not None:
            raise make_fault("cannot be combined with velocity or spin", "displacement")
        if isinstance(self.displacement, tuple) and self.history is None:
            raise make_fault('missing: displacement needs it, such as "ramp(t/0.5)"', "history")
        if isinstance(self.displacement, PythonValue) and self.history is not None:
            raise make_fault("cannot be combined with a function, which depends on t itself", "history")
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
