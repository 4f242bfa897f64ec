"""The slices of the stability study: what is taken to its extremes, how far, and how a case is changed for it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import degrees
from typing import Any

from pipeline.case import Case
from pipeline.mesh.simplex import Mesh
from pipeline.problem.methods import IMPLICIT_STEPPERS

Settings = dict[str, Any]
EXPLICIT = "symplectic_euler"
_KINDS: Mapping[str, Settings] = {
    "linear": {"law": "linear"},
    "polar": {},
    "gram_schmidt": {"rotation": "gram_schmidt"},
    "three_passes": {"iterations": 3},
    "converged": {"iterations": "converged"},
    "auto": {"model": "auto"},
}
# every method by its name; an explicit step solves nothing, so that passes mean nothing to it
METHODS: Mapping[str, Settings] = {
    f"{kind} {stepper}": {**changes, "stepper": stepper}
    for stepper in IMPLICIT_STEPPERS
    for kind, changes in _KINDS.items()
} | {
    f"{kind} {EXPLICIT}": {**_KINDS[kind], "stepper": EXPLICIT, "mass": "lumped"}
    for kind in ("linear", "polar", "gram_schmidt")
}
# of an explicit method's limit, where the step is not what is studied
LIMIT_SHARE = 0.5
# an explicit step is short: this many times the steps of an implicit run
EXPLICIT_STEPS = 5
# of the speed of sound over the body's size: stretches a body in spin by about a hundredth (.4^2 / 8)
_SPIN_SPEED = 0.4


@dataclass(frozen=True)
class ExtremeScene:
    """A case and the numbers of its body that extremes are measured by: dimension, size [m], speed of sound [m/s]."""

    case: Case
    dimension: int
    size: float
    sound: float

    @classmethod
    def of(cls, case: Case, mesh: Mesh) -> "ExtremeScene":
        """Return the scene of a case with that mesh."""
        m = case.material
        return cls(case, mesh.dimension, mesh.size, (m.youngs_modulus / m.density) ** 0.5)


@dataclass(frozen=True)
class Slice:
    """One quantity taken to its extremes: the values, and the settings of a trial at one of them.

    `judged` says against what: "converged", the converged solution of the same steps, or "rest", the rest shape.
    """

    units: str
    long_name: str
    values: Callable[[ExtremeScene], tuple[float, ...]]
    settings: Callable[[ExtremeScene, float], Settings]
    judged: str = "converged"


def _make_spin(scene: ExtremeScene, angle: float) -> Settings:
    """Return a free body that turns by the angle [rad] in a step, about an axis of no symmetry."""
    rate = _SPIN_SPEED * scene.sound / scene.size
    axis = [0.0, 0.0, 1.0] if scene.dimension == 2 else [1.0, 0.3, 0.2]
    spin = {"axis": axis, "rate": degrees(rate)}
    return {
        "changes": {"supports": [], "loads": {}, "initial": {"spin": spin}, "schedule.dt": angle / rate},
        "own_step": True,
    }


def _make_unloaded(scene: ExtremeScene, **disturbance: float) -> Settings:
    """Return a body without loads or motion, so that its rest shape is where it belongs, disturbed."""
    held = [{k: v for k, v in support.items() if k != "motion"} for support in scene.case.as_dict().get("supports", ())]
    return {"changes": {"supports": held, "loads": {}, "initial": {}}, **disturbance}


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
        "angle that a free body turns by in a step",
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
        lambda scene: _make_decades(scene.case.material.youngs_modulus),
        lambda scene, E: {"changes": {"material.youngs_modulus": E}},
    ),
    "density": Slice(
        "kg m-3",
        "density",
        lambda scene: _make_decades(scene.case.material.density),
        lambda scene, rho: {"changes": {"material.density": rho}},
    ),
    "sliver": Slice(
        "1",
        "height of some cells over what it was",
        lambda scene: (1e-3, 1e-2, 0.1, 0.5, 1.0),
        lambda scene, height: {"changes": {}, "sliver": height},
    ),
    "scramble": Slice(
        "1",
        "way of every node along every axis, at most, over the size of the body",
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
    """Return all that the trial of one method at one value of a slice depends on, as plain JSON."""
    case, one = scene.case, SLICES[name]
    document = case.as_dict()
    kept = ("linear_solver", "linear_rtol", "volume_tolerance", "tolerance", "max_iterations", "tangent", "mass")
    settings = one.settings(scene, value)
    explicit = METHODS[method]["stepper"] == EXPLICIT
    return {
        "case": str(case.path.resolve()),
        "scene": {
            key: document[key] for key in ("mesh", "material", "supports", "loads", "initial") if key in document
        },
        "changes": {
            "method": {key: document["method"][key] for key in kept},
            "schedule": {"dt": case.schedule.dt, "frames": steps * (EXPLICIT_STEPS if explicit else 1)},
            **settings.pop("changes"),
        },
        "method": METHODS[method],
        "limit_share": LIMIT_SHARE if explicit and not settings.pop("own_step", False) else None,
        "disturbance": {key: amount for key, amount in settings.items() if key != "own_step"},
        "judged": one.judged,
        "tolerance": tolerance,
        "seed": 0,
    }
