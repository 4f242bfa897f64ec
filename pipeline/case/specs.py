"""The sections of a case file. Names of laws, steppers and shapes are free here: build.py owns the tables."""

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, model_validator

from pipeline.case.values import (
    AxisName,
    Count,
    Direction,
    EvenCount,
    FolderName,
    Fraction,
    FrameRate,
    Iterations,
    NodeNumber,
    Number,
    PoissonRatio,
    Positive,
    Text,
    Vector,
    choice,
    entries,
    fault,
    folder_name,
)
from pipeline.errors import join_names, quote_value

# A ratio this near to a whole number is meant to be one: 0.3 / 0.1 is not 3 in floating point.
INTERVAL_RTOL = 1e-9
VARIANT_SECTIONS = ("mesh", "material", "supports", "loads", "initial", "method", "schedule", "output")
ONLY_VARIANT = "default"


class Spec(BaseModel):
    """A table of the case file: frozen, every key known."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    def implied(self) -> frozenset[str]:
        """The attributes that are not written to a file, because others determine them."""
        return frozenset()


class MeshSpec(Spec):
    """Either a shape with its size [m] and cells, or a file with the scale that makes it metres."""

    shape: Text | None = None
    size: Annotated[tuple[Positive, ...], entries(2, 3)] | None = None
    cells: Annotated[tuple[Count, ...], entries(2, 3)] | None = None
    split: Text = "kuhn"
    file: Text | None = None
    scale: Positive = 1.0

    @model_validator(mode="after")
    def _one_source(self) -> "MeshSpec":
        if (self.shape is None) == (self.file is None):
            both = self.shape is not None
            raise fault("shape and file exclude each other" if both else "neither shape nor file")
        foreign = self.implied() & {key for key in self.model_fields_set if getattr(self, key) is not None}
        if foreign:
            source = "file" if self.file is None else "shape"
            raise fault(f"goes with {source}, which is not given", min(foreign))
        if self.file is None:
            for key in ("size", "cells"):
                if getattr(self, key) is None:
                    raise fault("missing", key)
            lengths = len(self.cells or ()), len(self.size or ())
            if lengths[0] != lengths[1]:
                raise fault(f"has {lengths[0]} entries, but size has {lengths[1]}", "cells")
        return self

    def implied(self) -> frozenset[str]:
        return frozenset({"scale"} if self.file is None else {"size", "cells", "split"})


class MaterialSpec(Spec):
    """Young's modulus [Pa], Poisson's ratio, density [kg/m3]."""

    youngs_modulus: Positive
    poisson_ratio: PoissonRatio
    density: Positive


class SphereSpec(Spec):
    """A ball [m]."""

    center: Vector
    radius: Positive


class HalfSpaceSpec(Spec):
    """All that lies on one side of `at` [m] along an axis."""

    axis: AxisName
    at: Number


class SpinSpec(Spec):
    """A rotation about an axis through `center` [m] at `rate` [degree/s]."""

    axis: Direction
    rate: Number
    center: Vector | None = None


class MotionSpec(Spec):
    """How supported nodes move: velocity [m/s], spin, or both."""

    velocity: Vector | None = None
    spin: SpinSpec | None = None

    @model_validator(mode="after")
    def _some_motion(self) -> "MotionSpec":
        if self.velocity is None and self.spin is None:
            raise fault("neither velocity nor spin")
        return self


def _box(corners: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
    low, high = corners
    if len(low) != len(high):
        raise fault(f"corners have {len(low)} and {len(high)} entries")
    if any(a > b for a, b in zip(low, high, strict=True)):
        raise fault(f"{quote_value(list(low))} is not below {quote_value(list(high))}; write [[lowest], [highest]]")
    return corners


class SelectorSpec(Spec):
    """Nodes, chosen by exactly one of plane (with at), box, sphere, below, above [m, scaled] or nodes."""

    plane: AxisName | None = None
    at: Number | None = None
    box: Annotated[tuple[Vector, ...], entries(2, 2), AfterValidator(_box)] | None = None
    sphere: SphereSpec | None = None
    below: HalfSpaceSpec | None = None
    above: HalfSpaceSpec | None = None
    nodes: Annotated[tuple[NodeNumber, ...], entries(1)] | None = None

    @model_validator(mode="after")
    def _one_selector(self) -> "SelectorSpec":
        kinds = ("plane", "box", "sphere", "below", "above", "nodes")
        given = [kind for kind in kinds if getattr(self, kind) is not None]
        if self.at is not None and not given:
            raise fault("goes with plane, which is not given", "at")
        if not given:
            raise fault(f"no selector; give one of {', '.join(kinds)}")
        if len(given) > 1:
            raise fault(f"{given[0]} and {given[1]} exclude each other")
        if (self.plane is None) != (self.at is None):
            raise fault("missing" if self.at is None else "goes with plane, which is not given", "at")
        return self


class SupportSpec(SelectorSpec):
    """Nodes that are held, or moved as `motion` says."""

    motion: MotionSpec | None = None


class TractionSpec(SelectorSpec):
    """A traction [Pa] along the outward normal of the rest surface, where its nodes are selected."""

    normal_traction: Number


class BodyForceSpec(Spec):
    """A force per volume [N/m3] and the factor it is multiplied by."""

    value: Vector
    factor: Number = 1.0


def _body_force(value: Any) -> Any:
    return {"value": value} if isinstance(value, list | tuple) else value


class LoadsSpec(Spec):
    """Gravity [m/s2], body force, tractions."""

    gravity: Vector | None = None
    body_force: Annotated[BodyForceSpec | None, BeforeValidator(_body_force)] = None
    traction: tuple[TractionSpec, ...] = ()


class InitialSpec(Spec):
    """The initial velocity [m/s] and spin, both multiplied by factor."""

    velocity: Vector | None = None
    spin: SpinSpec | None = None
    factor: Number = 1.0


class MethodSpec(Spec):
    """What is swapped between variants; names are keys of the tables in methods.py."""

    model: Annotated[str, choice("fixed", "auto")] = "fixed"
    volume_tolerance: Fraction = 0.01
    law: Text = "corotational"
    rotation: Text = "polar"
    stepper: Text = "backward_euler"
    iterations: Iterations = 1
    mass: Annotated[str, choice("consistent", "lumped")] = "consistent"
    linear_solver: Text = "auto"
    linear_rtol: Fraction = 1e-8
    tolerance: Fraction = 1e-9
    max_iterations: Count = 100
    tangent: Annotated[str, choice("projected", "exact", "frozen")] = "projected"
    inversion: Text = "flip"


class ScheduleSpec(Spec):
    """Time step [s] and frames after the initial one; frame_interval [s] sets steps_per_frame."""

    dt: Positive
    steps_per_frame: Count = 1
    frame_interval: Positive | None = None
    frames: Count

    @model_validator(mode="before")
    @classmethod
    def _one_rhythm(cls, value: Any) -> Any:
        if isinstance(value, dict) and {"frame_interval", "steps_per_frame"} <= value.keys():
            raise fault("frame_interval and steps_per_frame exclude each other")
        return value

    @model_validator(mode="after")
    def _whole_steps(self) -> "ScheduleSpec":
        if self.frame_interval is None:
            return self
        ratio = self.frame_interval / self.dt
        steps = round(ratio) if ratio < 1e9 else 0
        if steps < 1 or abs(ratio - steps) > INTERVAL_RTOL * ratio:
            raise fault(f"{self.frame_interval} is not a multiple of dt = {self.dt}", "frame_interval")
        return self.model_copy(update={"steps_per_frame": steps})

    def implied(self) -> frozenset[str]:
        return frozenset() if self.frame_interval is None else frozenset({"steps_per_frame"})


class OutputSpec(Spec):
    """How frames are written; the wall time or the frames between two checkpoints, which no result depends on.

    With `precision` float32 the fields in the frames are rounded; statistics.nc is float64 always.
    """

    format: Annotated[str, choice("vtu", "vtkhdf")] = "vtu"
    precision: Annotated[Literal["float64", "float32"], choice("float64", "float32")] = "float64"
    checkpoint_seconds: Positive = 10.0
    checkpoint_frames: Count | None = None


class MovieSpec(Spec):
    """Which variants are drawn side by side and how; `speed` is movie time over simulated time."""

    variants: tuple[Text, ...] = ()
    speed: Positive = 1.0
    fps: FrameRate = 30
    size: Annotated[tuple[EvenCount, ...], entries(2, 2)] = (1280, 720)
    title: Text | None = None


class CaseFile(Spec):
    """All that a case file can say."""

    name: FolderName
    mesh: MeshSpec
    material: MaterialSpec
    supports: tuple[SupportSpec, ...] = ()
    loads: LoadsSpec = LoadsSpec()
    initial: InitialSpec = InitialSpec()
    method: MethodSpec = MethodSpec()
    schedule: ScheduleSpec
    output: OutputSpec = OutputSpec()
    movie: MovieSpec = MovieSpec()
    variants: dict[str, dict[str, Any]] = {}

    @model_validator(mode="after")
    def _movie_of_known_variants(self) -> "CaseFile":
        known = tuple(self.variants) or (ONLY_VARIANT,)
        for index, name in enumerate(self.movie.variants):
            if name not in known:
                message = f"no variant {quote_value(name)}; choose from {join_names(known)}"
                raise fault(message, "movie", "variants", str(index))
            if name in self.movie.variants[:index]:
                raise fault(f"{quote_value(name)} is listed twice", "movie", "variants", str(index))
        return self

    @model_validator(mode="after")
    def _variant_keys(self) -> "CaseFile":
        for name, overrides in self.variants.items():
            try:
                folder_name(name)
            except ValueError as error:
                raise fault(str(error), "variants", name) from None
            for key in overrides:
                section = key.split(".")[0]
                if section in CaseFile.model_fields.keys() - set(VARIANT_SECTIONS):
                    message = f"a variant cannot change {section}, only {', '.join(VARIANT_SECTIONS)}"
                    raise fault(message, "variants", name, key)
        return self
