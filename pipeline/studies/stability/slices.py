"""The slices of the stability study: the quantities taken to extremes, their values, and the changes of a case."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import degrees
from typing import Any

from pipeline.case import Case, MaterialSpec
from pipeline.mesh.element_mesh import ElementMesh
from pipeline.problem.methods import IMPLICIT_STEPPERS, STEP_LIMITS

Settings = dict[str, Any]
_KINDS: Mapping[str, Settings] = {
    "linear": {"law": "linear"},
    "polar": {},
    "gram_schmidt": {"rotation": "gram_schmidt"},
    "three_passes": {"iterations": 3},
    "converged": {"iterations": "converged"},
    "auto": {"model": "auto"},
}
# every method by its name; an explicit step solves nothing, so it has no iterations
METHODS: Mapping[str, Settings] = {
    f"{kind} {stepper}": {**changes, "stepper": stepper}
    for stepper in IMPLICIT_STEPPERS
    for kind, changes in _KINDS.items()
} | {
    f"{kind} {stepper}": {**_KINDS[kind], "stepper": stepper, "mass": "lumped"}
    for stepper in STEP_LIMITS
    for kind in ("linear", "polar", "gram_schmidt")
}
_LIMIT_SHARE = 0.5  # an explicit step over its limit, unless the step is the quantity studied
_EXPLICIT_STEPS = 5  # times the steps of an implicit run, as explicit ones are short
_SPIN_SPEED = 0.4  # of the speed of sound over the body's size: a spin then stretches it by about 1 % (.4^2 / 8)
# keys of the case's method that hold for every method of the study
_COMMON_KEYS = ("linear_solver", "linear_rtol", "volume_tolerance", "tolerance", "max_iterations", "tangent", "mass")


@dataclass(frozen=True)
class ExtremeScene:
    """A case and the numbers of its body that scale the extremes: dimension, size [m], speed of sound [m/s]."""

    case: Case
    dimension: int
    size: float
    sound: float

    @classmethod
    def from_mesh(cls, case: Case, mesh: ElementMesh) -> "ExtremeScene":
        """Return the scene of a case with that mesh."""
        m = _require_material(case)
        return cls(case, mesh.dimension, mesh.size, (m.youngs_modulus / m.density) ** 0.5)


def _require_material(case: Case) -> MaterialSpec:
    """Return the material whose values are taken to extremes; raises CaseError if only regions have one."""
    if case.material is None:
        raise case.make_error("material", "missing; its values are taken to their extremes here")
    return case.material


@dataclass(frozen=True)
class Slice:
    """One quantity taken to its extremes: the values, and the settings of a trial at one of them.

    A trial is compared with the `reference`: "converged", the converged solution of the same steps, or "rest", the
    rest shape.
    """

    units: str
    long_name: str
    list_values: Callable[[ExtremeScene], tuple[float, ...]]
    make_settings: Callable[[ExtremeScene, float], Settings]
    reference: str = "converged"


def _make_spin(scene: ExtremeScene, angle: float) -> Settings:
    """Return the settings of a free body that turns by the angle [rad] in a step, about an axis without symmetry."""
    rate = _SPIN_SPEED * scene.sound / scene.size
    axis = [0.0, 0.0, 1.0] if scene.dimension == 2 else [1.0, 0.3, 0.2]
    spin = {"axis": axis, "rate": degrees(rate)}
    return {
        "changes": {"supports": [], "loads": {}, "initial": {"spin": spin}, "schedule.dt": angle / rate},
        "own_step": True,
    }


def _make_unloaded(scene: ExtremeScene, **disturbance: float) -> Settings:
    """Return the settings of a disturbed body without loads or motion, which should return to its rest shape."""
    supports = scene.case.as_dict().get("supports", ())
    fixed = [{key: value for key, value in support.items() if key != "motion"} for support in supports]
    return {"changes": {"supports": fixed, "loads": {}, "initial": {}}, **disturbance}


def _make_decades(middle: float) -> tuple[float, ...]:
    return tuple(middle * 10.0**power for power in (-6, -4, -2, 0, 2, 4, 6))


SLICES: Mapping[str, Slice] = {
    "dt": Slice(
        "s",
        "time step",
        lambda scene: (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0),
        lambda scene, dt: {"changes": {"schedule.dt": dt}, "own_step": True},
    ),
    "spin": Slice(
        "rad",
        "rotation of a free body in a step",
        lambda scene: (0.01, 0.05, 0.2, 0.5, 1.0, 2.0, 5.0, 20.0, 50.0),
        _make_spin,
    ),
    "poisson_ratio": Slice(
        "1",
        "Poisson's ratio",
        lambda scene: (-1.0, -0.99, -0.9, -0.5, 0.0, 0.3, 0.45, 0.49, 0.499, 0.4999, 0.5),
        lambda scene, nu: {"changes": {"material.poisson_ratio": nu}},
    ),
    "youngs_modulus": Slice(
        "Pa",
        "Young's modulus",
        lambda scene: _make_decades(_require_material(scene.case).youngs_modulus),
        lambda scene, E: {"changes": {"material.youngs_modulus": E}},
    ),
    "density": Slice(
        "kg m-3",
        "density",
        lambda scene: _make_decades(_require_material(scene.case).density),
        lambda scene, rho: {"changes": {"material.density": rho}},
    ),
    "sliver": Slice(
        "1",
        "height of some cells over their height before",
        lambda scene: (1e-3, 1e-2, 0.1, 0.5, 1.0),
        lambda scene, height: {"changes": {}, "sliver": height},
    ),
    "scramble": Slice(
        "1",
        "largest displacement of every node along every axis, over the size of the body",
        lambda scene: (0.01, 0.03, 0.1, 0.226, 0.5, 1.0),  # 0.226 is 3 m in the thesis' bar
        lambda scene, reach: _make_unloaded(scene, scramble=reach * scene.size),
        "rest",
    ),
    "inversion": Slice(
        "1",
        "depth of some apexes below their bases over the height of the cell",
        lambda scene: (0.2, 0.5, 0.8, 1.2, 2.0, 5.0),
        lambda scene, depth: _make_unloaded(scene, inversion=depth),
        "rest",
    ),
}


def make_trial_settings(
    scene: ExtremeScene, name: str, value: float, method: str, *, steps: int, tolerance: float
) -> Settings:
    """Return the settings that the trial of one method at one value of a slice depends on, as plain JSON."""
    case = scene.case
    document = case.as_dict()
    settings = SLICES[name].make_settings(scene, value)
    is_explicit = METHODS[method]["stepper"] in STEP_LIMITS
    return {
        "case": str(case.path.resolve()),
        "scene": {
            key: document[key] for key in ("mesh", "material", "supports", "loads", "initial") if key in document
        },
        "changes": {
            "method": {key: document["method"][key] for key in _COMMON_KEYS},
            "schedule": {"dt": case.schedule.dt, "frames": steps * (_EXPLICIT_STEPS if is_explicit else 1)},
            **settings.pop("changes"),
        },
        "method": METHODS[method],
        "limit_share": _LIMIT_SHARE if is_explicit and not settings.pop("own_step", False) else None,
        "disturbance": {key: amount for key, amount in settings.items() if key != "own_step"},
        "reference": SLICES[name].reference,
        "tolerance": tolerance,
        "seed": 0,
    }
