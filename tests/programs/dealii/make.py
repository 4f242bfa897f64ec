"""Files of deal.II 9.4 (Debian), by bar.cc.

apt install libdeal.ii-dev cmake g++;  python3 make.py
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))
from expected import TIMES, make_expectation, write_expected  # noqa: E402


def main():
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(["cmake", "-DCMAKE_BUILD_TYPE=Release", str(HERE)], cwd=folder, check=True)
        subprocess.run(["make"], cwd=folder, check=True)
        subprocess.run([f"{folder}/bar"], cwd=HERE, check=True)
    lines = [line.split() for line in (HERE / "values.txt").read_text().splitlines()]
    (HERE / "values.txt").unlink()
    entries = []
    for name in ("linear", "lagrange"):
        rows = np.array([line[1:] for line in lines if line[0] == name], dtype=float).reshape(len(TIMES), -1, 16)
        entries.append(
            make_expectation(
                "deal.II 9.4.1",
                f"{name}.pvd",
                TIMES,
                centers=rows[0, :, 4:7],
                rest_volumes=rows[0, :, 2],
                volumes=rows[:, :, 3],
                gradients=rows[:, :, 7:16].reshape(len(TIMES), -1, 3, 3),
                accuracy=2e-5,
            )
        )
    write_expected(HERE, *entries)


if __name__ == "__main__":
    main()
