"""A TOML file becomes a validated, frozen Case with overrides and variants; no numerics are imported here."""

from pipeline.case.keys import MeshSpec, MethodSpec, MovieSpec, OutputSpec, ScheduleSpec
from pipeline.case.loads import BodyForceSpec, GravitySpec, LoadsSpec, PointLoadSpec, TractionSpec
from pipeline.case.materials import MaterialSpec, RegionSpec
from pipeline.case.model import Case, load_case
from pipeline.case.motions import InitialSpec, MotionSpec, SpinSpec, SupportSpec
from pipeline.case.overrides import parse_override
from pipeline.case.selectors import HalfSpaceSpec, SelectorSpec, SphereSpec

__all__ = [
    "BodyForceSpec",
    "Case",
    "GravitySpec",
    "HalfSpaceSpec",
    "InitialSpec",
    "LoadsSpec",
    "MaterialSpec",
    "MeshSpec",
    "MethodSpec",
    "MotionSpec",
    "MovieSpec",
    "OutputSpec",
    "PointLoadSpec",
    "RegionSpec",
    "ScheduleSpec",
    "SelectorSpec",
    "SphereSpec",
    "SpinSpec",
    "SupportSpec",
    "TractionSpec",
    "load_case",
    "parse_override",
]
