r"""Differences between two motions: nodes, volumes, energy, and the first mode.

With the first mode phi (M-normalized, omega) of the body at rest,  q = phi . M u,  z = q + i dq/dt / omega:
its amplitude is |z|, its phase arg z. In large rotations phi is no longer a mode, but both motions are still projected
alike.
"""

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Floats, Ints
from pipeline.errors import SolveError
from pipeline.fem.body import Body
from pipeline.fem.modes import find_lowest_frequencies
from pipeline.studies.tradeoff.motion import RecordedMotion

# unit and meaning of every measure
MEASURES = {
    "worst_distance": ("1", "largest distance of a node from the reference, over the body's size"),
    "rms_distance": ("1", "root mean square over nodes and instants of that distance, over the body's size"),
    "volume": ("1", "largest difference of a cell's volume ratio from the reference"),
    "drift": ("1", "largest difference of the relative change of total volume"),
    "energy": ("1", "largest difference of the total energy, over the largest kinetic and elastic one"),
    "mode_amplitude": ("1", "largest difference of the first mode's amplitude, over its largest"),
    "mode_phase": ("degree", "largest difference of the first mode's phase while it moves"),
}
DISTANCES = ("worst_distance", "rms_distance")
# an error of a volume ratio counts half: model = "auto" promises to keep it below twice the tolerance
VOLUME_SHARE = 0.5
_MOVING = 0.1  # of the largest amplitude: below this, a phase means little


@dataclass(frozen=True, eq=False)
class FirstMode:
    """The lowest elastic mode of a body: M phi (n, d) and omega [rad/s]."""

    weighted: Floats
    omega: float

    def project(self, motion: RecordedMotion) -> Floats:
        """Return z of a motion (t,), complex."""
        q, rate = (np.einsum("tnd,nd->t", field, self.weighted) for field in (motion.u, motion.v))
        return np.asarray(q + 1j * rate / self.omega)


def find_first_mode(body: Body) -> FirstMode | None:
    """Return the lowest elastic mode of a body; None if it has none or none is found."""
    try:
        omegas, modes = find_lowest_frequencies(body)
    except SolveError:
        return None
    return FirstMode(body.momentum(modes[0]), float(omegas[0])) if len(omegas) else None


def measure_distances(
    motion: RecordedMotion, reference: RecordedMotion, nodes: tuple[Ints, Ints] | None = None
) -> dict[str, float]:
    """Return the worst and RMS distance over the body's size; `nodes` are those of both that are at one place."""
    u, other = (motion.u, reference.u) if nodes is None else (motion.u[:, nodes[0]], reference.u[:, nodes[1]])
    distance = np.linalg.norm(u - other, axis=-1) / motion.mesh.size
    return {"worst_distance": float(distance.max()), "rms_distance": float(np.sqrt(np.mean(distance**2)))}


def measure_deviation(motion: RecordedMotion, reference: RecordedMotion, mode: FirstMode | None) -> dict[str, float]:
    """Return every measure of MEASURES between two motions of one mesh; NaN if it is undefined."""
    scale = float(reference.moving_energy.max())
    energy = float(np.abs(motion.energy - reference.energy).max())
    out = measure_distances(motion, reference) | {
        "volume": float(np.abs(motion.ratios - reference.ratios).max()),
        "drift": float(np.abs(motion.drift - reference.drift).max()),
        "energy": energy / scale if scale > 0 else float("nan"),
        "mode_amplitude": float("nan"),
        "mode_phase": float("nan"),
    }
    if mode is not None:
        z, exact = mode.project(motion), mode.project(reference)
        largest = float(np.abs(exact).max())
        moving = np.abs(exact) > _MOVING * largest
        if moving.any():
            out["mode_amplitude"] = float(np.abs(np.abs(z) - np.abs(exact)).max()) / largest
            out["mode_phase"] = float(np.degrees(np.abs(np.angle(z[moving] * exact[moving].conj())).max()))
    return out


def combine_error(measures: dict[str, float]) -> float:
    """Return the error that is compared with a tolerance: worst distance or half the worst volume, the larger."""
    return max(measures["worst_distance"], VOLUME_SHARE * measures.get("volume", 0.0))
