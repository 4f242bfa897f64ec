"""Motion that all programs of this folder are given, and the file with the values that their results must have.

Every make.py computes the values from the program's own arrays and integrals. Nothing here imports the package.
"""

import json
from pathlib import Path

import numpy as np

TIMES = (0.0, 0.25, 0.5, 1.0)
STRETCH, TWIST = 0.2, np.pi / 3  # at t = 1, over the length 2 of the bar


def move_bar(X, t):
    """Return the positions (n, 3) at time t of points X (n, 3): a bar along x, stretched and twisted about its axis."""
    X = np.asarray(X, dtype=float)
    angle = TWIST * t * X[:, 0] / 2
    y, z = X[:, 1] - 0.5, X[:, 2] - 0.5
    return np.stack(
        [
            (1 + STRETCH * t) * X[:, 0],
            0.5 + np.cos(angle) * y - np.sin(angle) * z,
            0.5 + np.sin(angle) * y + np.cos(angle) * z,
        ],
        axis=1,
    )


def move_plate(X, t):
    """Return the positions (n, 2) at time t of points X (n, 2): stretched, then turned by 60 degrees at t = 1."""
    X = np.asarray(X, dtype=float)
    x = np.stack([(1 + STRETCH * t) * X[:, 0] + 0.1 * t * X[:, 0] * X[:, 1], X[:, 1]], axis=1)
    c, s = np.cos(TWIST * t), np.sin(TWIST * t)
    return x @ np.array([[c, s], [-s, c]])


def rotation_angles(F):
    """Return the angles in degrees of the polar rotations of F (..., d, d), by singular values."""
    F = np.asarray(F, dtype=float)
    U, _, Vt = np.linalg.svd(F)
    U[..., -1] *= np.sign(np.linalg.det(U @ Vt))[..., None]
    R = U @ Vt
    trace = np.trace(R, axis1=-2, axis2=-1)
    cosine = trace / 2 if F.shape[-1] == 2 else (trace - 1) / 2
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def make_expectation(program, series, times, *, centers, rest_volumes, volumes, gradients, **more):
    """Return one entry of expected.json.

    `centers` (cell, d) are the means of the corner nodes at rest, `volumes` (time, cell) the integrals of det F,
    `gradients` (time, cell, d, d) the means of F over the rest volume. `more`: the options that the series needs
    (`options`), the accuracy of the file (`accuracy`), the name of a field.
    """
    rest_volumes, volumes = np.asarray(rest_volumes, dtype=float), np.asarray(volumes, dtype=float)
    return {
        "program": program,
        "series": series,
        "times": [float(t) for t in times],
        "centers": np.round(centers, 9).tolist(),
        "rest_volume": digits(rest_volumes),
        "volume_ratio": digits(volumes / rest_volumes),
        "rotation_angle": digits(rotation_angles(gradients)),
        "total_volume": digits(volumes.sum(axis=1)),
        **more,
    }


def make_refusal(program, series, text):
    """Return an entry of expected.json for a series that must be refused with an error that has the text (a regex)."""
    return {"program": program, "series": series, "refused": text}


def make_note(program, series, text):
    """Return an entry for a series that opens as a body at rest, with a note that has the text (a regex)."""
    return {"program": program, "series": series, "noted": text}


def digits(values):
    """Return nested lists of the values with eleven significant digits."""
    return np.vectorize(lambda v: float(f"{v:.11g}"))(np.asarray(values, dtype=float)).tolist()


def write_expected(folder, *entries):
    """Write expected.json in the folder."""
    lines = ",\n".join("  " + json.dumps(entry) for entry in entries)
    (Path(folder) / "expected.json").write_text(f"[\n{lines}\n]\n")
