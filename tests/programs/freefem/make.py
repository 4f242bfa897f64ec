"""Files of FreeFEM 4.9 (Debian), by make.edp: numbered .vtu with the field u, and with moving points.

apt install freefem++ libfreefem++;  python3 make.py
"""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))
from expected import TIMES, make_expectation, write_expected  # noqa: E402

PLUGINS = "/usr/lib/freefem++"


def main():
    os.chdir(HERE)
    subprocess.run(["FreeFem++", "-nw", "make.edp"], check=True, env={**os.environ, "FF_LOADPATH": PLUGINS})
    rows = np.loadtxt("values.txt")
    Path("values.txt").unlink()
    rows = rows.reshape(len(TIMES), -1, rows.shape[1])
    entries = []
    for series in ("bar_*.vtu", "moved_*.vtu"):
        entries.append(
            make_expectation(
                "FreeFEM 4.9",
                series,
                range(len(TIMES)),
                centers=rows[0, :, 4:16].reshape(-1, 4, 3).mean(axis=1),
                rest_volumes=rows[0, :, 2],
                volumes=rows[:, :, 3],
                gradients=rows[:, :, 16:].reshape(len(TIMES), -1, 3, 3),
                accuracy=1e-6,
            )
        )
    write_expected(HERE, *entries)


if __name__ == "__main__":
    main()
