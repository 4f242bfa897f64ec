"""The sections of a case file, each key with its unit and one sentence.

Names of laws, steppers and shapes are not checked here: the tables in problem/methods.py define them.
"""

from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    model_validator,
)
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema
from pydantic_core.core_schema import no_info_before_validator_function

from pipeline.case.python_values import PythonValue
from pipeline.case.values import (
    AxisName,
    Count,
    Counts,
    Direction,
    ElementOrder,
    FiniteNumber,
    FolderName,
    Fraction,
    FrameRate,
    Iterations,
    Length,
    Lengths,
    NodeNumbers,
    OneOf,
    PictureSize,
    PoissonRatio,
    Positive,
    Text,
    Vector,
    check_folder_name,
    make_fault,
)
from pipeline.errors import join_names, quote_value
from pipeline.system.times import count_intervals

VARIANT_SECTIONS = ("mesh", "material", "supports", "loads", "initial", "method", "schedule", "output")
ONLY_VARIANT = "default"


def about(description: str, unit: str | None = None) -> FieldInfo:
    """Return the metadata of a key: its sentence and its unit, for the JSON Schema and the docs."""
    extra = None if unit is None else {"unit": unit}
    return Field(description=description, json_schema_extra=extra)  # type: ignore[arg-type]  # its JSON type is invariant


class Spec(BaseModel):
    """A table of the case file: frozen, with known keys only."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    def derived_keys(self) -> frozenset[str]:
        """Return the attributes that follow from others and so are not written to a file."""
        return frozenset()


class MeshSpec(Spec):
    """The mesh: a shape with its size and cells, a file with a scale, or arrays from Python."""

    shape: Annotated[Text | None, about("a simple shape that is meshed automatically")] = None
    size: Annotated[Lengths | None, about("extent of the shape along each axis", "m")] = None
    cells: Annotated[Counts | None, about("blocks along each axis, each of which is split into simplices")] = None
    split: Annotated[Text, about("how a block is split into simplices")] = "kuhn"
    order: Annotated[ElementOrder, about("degree of the shape functions, 1 or 2; 2 is cheaper for an accuracy")] = 1
    file: Annotated[Text | None, about("a mesh file (docs/meshes.md), relative to the case file")] = None
    scale: Annotated[Positive, about("factor that turns the file's coordinates into meters")] = 1.0
    arrays: Annotated[PythonValue | None, about("points and cells, given in Python")] = None

    @model_validator(mode="after")
    def _check_source(self) -> "MeshSpec":
        sources = [key for key in ("shape", "file", "arrays") if getattr(self, key) is not None]
        if len(sources) != 1:
            raise make_fault(
                f"{sources[0]} and {sources[1]} cannot be combined" if sources else "neither shape nor file is given"
            )
        misplaced = self.derived_keys() & {key for key in self.model_fields_set if getattr(self, key) is not None}
        if misplaced:
            source = "shape" if min(misplaced) != "scale" else "file"
            raise make_fault(f"needs {source}, which is not given", min(misplaced))
        if self.shape is not None:
            for key in ("size", "cells"):
                if getattr(self, key) is None:
                    raise make_fault("missing", key)
            lengths = len(self.cells or ()), len(self.size or ())
            if lengths[0] != lengths[1]:
                raise make_fault(f"has {lengths[0]} entries, but size has {lengths[1]}", "cells")
        return self

    def derived_keys(self) -> frozenset[str]:
        keys = {"size", "cells", "split", "scale"}
        return frozenset(keys - ({"scale"} if self.file else {"size", "cells", "split"} if self.shape else set()))


class MaterialSpec(Spec):
    """The material: isotropic and linear."""

    youngs_modulus: Annotated[Positive, about("Young's modulus", "Pa")]
    poisson_ratio: Annotated[PoissonRatio, about("Poisson's ratio, above -1 and below 0.5")]
    density: Annotated[Positive, about("mass per rest volume", "kg/m3")]


class SphereSpec(Spec):
    """A ball."""

    center: Annotated[Vector, about("center of the ball", "m")]
    radius: Annotated[Positive, about("radius of the ball", "m")]


class HalfSpaceSpec(Spec):
    """Everything on one side of a plane."""

    axis: Annotated[AxisName, about("axis that the plane is perpendicular to")]
    at: Annotated[FiniteNumber, about("position of the plane along the axis", "m")]


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
        kinds = ("plane", "box", "sphere", "below", "above", "nodes")
        chosen = [kind for kind in kinds if getattr(self, kind) is not None]
        if self.at is not None and not chosen:
            raise make_fault("needs plane, which is not given", "at")
        if not chosen:
            raise make_fault(f"no selector; give one of {', '.join(kinds)}")
        if len(chosen) > 1:
            raise make_fault(f"{chosen[0]} and {chosen[1]} cannot be combined")
        if (self.plane is None) != (self.at is None):
            raise make_fault("missing" if self.at is None else "needs plane, which is not given", "at")
        return self


class SupportSpec(SelectorSpec):
    """Nodes that are held, or moved."""

    motion: Annotated[MotionSpec | None, about("how the nodes move; without it they stay at rest")] = None


class TractionSpec(SelectorSpec):
    """A traction on the boundary faces whose nodes are all selected."""

    normal_traction: Annotated[FiniteNumber, about("traction along the outward normal of the rest surface", "Pa")]


class BodyForceSpec(Spec):
    """A force per volume."""

    value: Annotated[Vector, about("force per rest volume", "N/m3")]
    factor: Annotated[FiniteNumber, about("factor by which value is multiplied")] = 1.0


class BareVector:
    """Annotation of a table that may be written as a bare vector, its `value`."""

    def check(self, value: Any) -> Any:
        """Return the table, made from the vector if only that is written."""
        return {"value": value} if isinstance(value, list | tuple) else value

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return no_info_before_validator_function(self.check, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        vector = {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 3}
        return {"anyOf": [vector, *handler(schema)["anyOf"]]}


class LoadsSpec(Spec):
    """Dead loads: they do not follow the deformation."""

    gravity: Annotated[Vector | None, about("acceleration due to gravity", "m/s2")] = None
    body_force: Annotated[
        BodyForceSpec | None,
        BareVector(),
        about("force per rest volume: a vector, or a table with value and factor", "N/m3"),
    ] = None
    traction: Annotated[tuple[TractionSpec, ...], about("tractions on parts of the boundary")] = ()
    body_force_field: Annotated[
        PythonValue | None, about("force per rest volume at the nodes, an array or a function of X and t", "N/m3")
    ] = None
    nodal_forces: Annotated[
        PythonValue | None, about("forces on the nodes, an array or a function of X and t", "N")
    ] = None


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


class MethodSpec(Spec):
    """The numerical method; variants usually change these keys."""

    model: Annotated[
        str, OneOf("fixed", "auto"), about("whether each step chooses its own model: linear, corotational…")
    ] = "fixed"
    volume_tolerance: Annotated[Fraction, about("largest spurious volume that a step may have if model = auto")] = 0.01
    law: Annotated[Text, about("elastic law")] = "corotational"
    rotation: Annotated[Text, about("how the corotational law finds the rotation of a cell")] = "polar"
    rotation_at: Annotated[
        str, OneOf("points", "element"), about("where cells of order 2 find rotations: at each point, or once per cell")
    ] = "points"
    stepper: Annotated[Text, about("time integrator")] = "backward_euler"
    iterations: Annotated[Iterations, about("linear solves per step, or converged")] = 1
    mass: Annotated[str, OneOf("consistent", "lumped"), about("mass matrix")] = "consistent"
    linear_solver: Annotated[Text, about("solver of the linear systems; auto chooses by size")] = "auto"
    linear_rtol: Annotated[Fraction, about("relative residual at which iterative linear solvers stop")] = 1e-8
    tolerance: Annotated[Fraction, about("relative residual at which Newton's method stops")] = 1e-9
    max_iterations: Annotated[Count, about("Newton iterations after which a step fails")] = 100
    tangent: Annotated[
        str, OneOf("projected", "exact", "frozen"), about("tangent stiffness for iterations = converged")
    ] = "projected"
    inversion: Annotated[Text, about("rotation of inverted cells")] = "flip"


class ScheduleSpec(Spec):
    """The time steps, and how many of them are recorded."""

    dt: Annotated[Positive, about("time step", "s")]
    steps_per_frame: Annotated[Count, about("steps between two recorded frames")] = 1
    frame_interval: Annotated[
        Positive | None, about("time between two frames, a multiple of dt; replaces steps_per_frame", "s")
    ] = None
    frames: Annotated[Count, about("frames after the initial one")]

    @model_validator(mode="before")
    @classmethod
    def _check_rhythm(cls, value: Any) -> Any:
        if isinstance(value, dict) and {"frame_interval", "steps_per_frame"} <= value.keys():
            raise make_fault("frame_interval and steps_per_frame cannot be combined")
        return value

    @model_validator(mode="after")
    def _set_steps_per_frame(self) -> "ScheduleSpec":
        if self.frame_interval is None:
            return self
        steps = count_intervals(self.frame_interval, self.dt)
        if steps is None:
            raise make_fault(f"{self.frame_interval} is not a multiple of dt = {self.dt}", "frame_interval")
        return self.model_copy(update={"steps_per_frame": steps})

    def derived_keys(self) -> frozenset[str]:
        return frozenset() if self.frame_interval is None else frozenset({"steps_per_frame"})


class OutputSpec(Spec):
    """How frames are written, and how often checkpoints are."""

    format: Annotated[str, OneOf("vtu", "vtkhdf"), about("format of the frames")] = "vtu"
    precision: Annotated[
        Literal["float64", "float32"],
        OneOf("float64", "float32"),
        about("precision of the fields in frames; datasets are always float64"),
    ] = "float64"
    checkpoint_seconds: Annotated[Positive, about("wall time between two checkpoints", "s")] = 10.0
    checkpoint_frames: Annotated[
        Count | None, about("frames between two checkpoints, in addition to checkpoint_seconds")
    ] = None


class MovieSpec(Spec):
    """The comparison movie."""

    variants: Annotated[tuple[Text, ...], about("variants to draw side by side; all if not given")] = ()
    speed: Annotated[Positive, about("simulated seconds per second of the movie")] = 1.0
    fps: Annotated[FrameRate, about("pictures per second, 1 to 120", "1/s")] = 30
    size: Annotated[PictureSize, about("width and height, even numbers", "pixel")] = (1280, 720)
    title: Annotated[Text | None, about("title of the movie and the plots; the case's name if not given")] = None


class CaseFile(Spec):
    """One scene and its variants."""

    name: Annotated[FolderName, about("name of the case and of its result folder")]
    mesh: Annotated[MeshSpec, about("rest mesh")]
    material: Annotated[MaterialSpec, about("material")]
    supports: Annotated[tuple[SupportSpec, ...], about("sets of held nodes")] = ()
    loads: Annotated[LoadsSpec, about("dead loads")] = LoadsSpec()
    initial: Annotated[InitialSpec, about("initial motion")] = InitialSpec()
    method: Annotated[MethodSpec, about("numerical method")] = MethodSpec()
    schedule: Annotated[ScheduleSpec, about("time steps and frames")]
    output: Annotated[OutputSpec, about("how frames are written to files")] = OutputSpec()
    movie: Annotated[MovieSpec, about("comparison movie")] = MovieSpec()
    variants: Annotated[
        dict[str, dict[str, Any]], about("named changes to this case: dotted keys in quotes with their new values")
    ] = {}

    @model_validator(mode="after")
    def _check_movie(self) -> "CaseFile":
        known = tuple(self.variants) or (ONLY_VARIANT,)
        for index, name in enumerate(self.movie.variants):
            if name not in known:
                message = f"no variant {quote_value(name)}; choose from {join_names(known)}"
                raise make_fault(message, "movie", "variants", str(index))
            if name in self.movie.variants[:index]:
                raise make_fault(f"{quote_value(name)} is listed twice", "movie", "variants", str(index))
        return self

    @model_validator(mode="after")
    def _check_variants(self) -> "CaseFile":
        for name, overrides in self.variants.items():
            try:
                check_folder_name(name)
            except ValueError as error:
                raise make_fault(str(error), "variants", name) from None
            for key in overrides:
                section = key.split(".")[0]
                if section in CaseFile.model_fields.keys() - set(VARIANT_SECTIONS):
                    message = f"a variant cannot change {section}, only {', '.join(VARIANT_SECTIONS)}"
                    raise make_fault(message, "variants", name, key)
        return self
