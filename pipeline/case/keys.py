"""The sections of a case file, each key with its unit and one sentence.

Names of laws, steppers and shapes are not checked here: the tables in problem/methods.py define them.
"""

from typing import Annotated, Any, Literal

from pydantic import model_validator

from pipeline.case.loads import LoadsSpec
from pipeline.case.materials import MaterialSpec, RegionSpec
from pipeline.case.motions import InitialSpec, SupportSpec
from pipeline.case.python_values import PythonValue
from pipeline.case.spec import Spec, about
from pipeline.case.values import (
    Count,
    Counts,
    ElementOrder,
    FolderName,
    Fraction,
    FrameRate,
    Iterations,
    Lengths,
    OneOf,
    PictureSize,
    Positive,
    Repeats,
    Text,
    check_folder_name,
    make_fault,
)
from pipeline.errors import join_names, quote_value
from pipeline.system.times import count_intervals

VARIANT_SECTIONS = ("mesh", "material", "materials", "supports", "loads", "initial", "method", "schedule", "output")
ONLY_VARIANT = "default"


class MeshSpec(Spec):
    """The mesh: a shape with its size and cells, a file with a scale, or arrays from Python."""

    shape: Annotated[Text | None, about("a simple shape that is meshed automatically")] = None
    size: Annotated[Lengths | None, about("extent of the shape along each axis", "m")] = None
    cells: Annotated[Counts | None, about("blocks along each axis, each of which is split into simplices")] = None
    split: Annotated[Text, about("how a block is split into simplices")] = "kuhn"
    order: Annotated[ElementOrder, about("degree of the shape functions, 1 or 2; take 2 if the body bends")] = 1
    file: Annotated[Text | None, about("a mesh file (docs/meshes.md), relative to the case file")] = None
    refine: Annotated[
        Repeats, about("how many times every cell is cut into 8, or 4 in the plane, of half its size")
    ] = 0
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
    volumetric: Annotated[
        str,
        OneOf("full", "mean"),
        about("dilatation of each point, or a mean over cells, which does not lock"),
    ] = "full"
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
    material: Annotated[MaterialSpec | None, about("material; may be left out if materials cover all cells")] = None
    materials: Annotated[
        tuple[RegionSpec, ...], about("materials of regions, which replace material there; later ones replace earlier")
    ] = ()
    supports: Annotated[tuple[SupportSpec, ...], about("sets of held nodes")] = ()
    loads: Annotated[LoadsSpec, about("dead loads")] = LoadsSpec()
    initial: Annotated[InitialSpec, about("initial motion")] = InitialSpec()
    method: Annotated[MethodSpec, about("numerical method")] = MethodSpec()
    schedule: Annotated[ScheduleSpec, about("time steps and frames")]
    output: Annotated[OutputSpec, about("how frames are written to files")] = OutputSpec()
    movie: Annotated[MovieSpec, about("comparison movie")] = MovieSpec()
    variants: Annotated[
        dict[str, dict[str, Any]], about("named changes to this case: dotted keys in quotes with their new values")
    ] = {}  # noqa: RUF012  (pydantic copies it)

    @model_validator(mode="after")
    def _check_material(self) -> "CaseFile":
        if self.material is None and not self.materials:
            raise make_fault("missing", "material")
        return self

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
