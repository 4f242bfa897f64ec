"""For `make test-paraview` only: a plain `pytest` skips this folder, as ParaView takes a gigabyte."""

import shutil

import pytest


@pytest.fixture(scope="session", autouse=True)
def _paraview():
    missing = [name for name in ("pvbatch", "paraview", "xvfb-run", "xauth") if shutil.which(name) is None]
    if missing:
        pytest.exit(f"not installed: {', '.join(missing)}; make test-paraview installs them on Debian", returncode=1)
