"""What is installed with us: licenses listed, versions pinned with hashes, no network; the same bytes every time."""

import os
import re
import subprocess
import sys
import tomllib
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from pipeline.case import load_case
from pipeline.results.case_run import run_case
from tests.bodies import skip_figures, write_case
from tests.results.test_resume import assert_same_results

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
WORDS = {
    "ISC": "ISC",
    "MIT": "MIT",
    "BSD": "BSD",
    "Apache": "Apache",
    "PSF": "PSF|Python Software Foundation",
    "MPL": "MPL|Mozilla",
}


def normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def needed(roots: list[str]) -> set[str]:
    """The packages that some need, and all that these need, as installed here."""
    found, todo = set(), [Requirement(root) for root in roots]
    while todo:
        one = todo.pop()
        if normal(one.name) in found:
            continue
        found.add(normal(one.name))
        for text in distribution(one.name).requires or ():
            more = Requirement(text)
            if more.marker is None or any(more.marker.evaluate({"extra": extra}) for extra in ("", *one.extras)):
                todo.append(more)
    return found


def read_licenses() -> dict[str, str]:
    text = (ROOT / "docs" / "licenses.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| (\S+) \| (.+?) \|$", text, flags=re.M))
    return {name: terms for name, terms in rows.items() if name not in ("package", "---")}


def test_every_package_at_run_time_is_listed_with_its_license():
    extras = PROJECT["optional-dependencies"]
    optional = []
    permissive = [text for name in extras if name not in ("bench", "dev", "docs", "mkl") for text in extras[name]]
    for text in permissive:
        try:
            distribution(Requirement(text).name)
            optional.append(text)
        except PackageNotFoundError:  # an extra need not be installed
            pass
    listed, installed = read_licenses(), needed([*PROJECT["dependencies"], *optional])
    assert installed - listed.keys() == set(), "not in docs/licenses.md"
    assert listed.keys() - installed <= {normal(Requirement(text).name) for text in permissive}
    for name in installed:
        metadata = distribution(name).metadata
        said = " ".join(
            str(line).split("\n")[0]
            for key in ("License-Expression", "License", "Classifier")
            for line in metadata.get_all(key, [])
            if key != "Classifier" or line.startswith("License")
        )
        family = re.match(r"[A-Za-z]+", listed[name])[0]
        assert re.search(WORDS[family], said), f"{name}: {listed[name]} here, there {said}"
        assert not re.search(r"\bA?GPL", said), name


def locked() -> dict[str, tuple[str, int]]:
    """Version and number of hashes of every package in the lock file."""
    text = (ROOT / "requirements-dev.lock").read_text(encoding="utf-8")
    entries = re.split(r"\n(?=[A-Za-z])", re.sub(r"^#.*\n", "", text, flags=re.M).strip())
    found = [re.match(r"([\w.-]+)(?:\[[\w,]+\])?==(\S+)", entry) for entry in entries]
    return {normal(one[1]): (one[2], entry.count("--hash=sha256:")) for one, entry in zip(found, entries, strict=True)}


def test_the_lock_file_covers_what_is_developed_with_at_the_versions_of_the_constraints():
    lock = locked()
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    constraints = {normal(line.split("==")[0]): line.split("==")[1] for line in lines if "==" in line}
    asked = [Requirement(text) for text in (*PROJECT["dependencies"], *PROJECT["optional-dependencies"]["dev"])]
    assert {normal(one.name) for one in asked} <= lock.keys()
    assert all(hashes for _, hashes in lock.values())
    assert {name: version for name, (version, _) in lock.items() if constraints.get(name) != version} == {}
    assert needed([str(one) for one in asked]) <= lock.keys()


LONELY = """
import sys
def refuse(event, arguments):
    if event in ("socket.connect", "socket.bind", "socket.sendto", "socket.getaddrinfo", "socket.gethostbyname"):
        place = arguments[1] if event in ("socket.connect", "socket.bind", "socket.sendto") else arguments[0]
        host = place[0] if isinstance(place, tuple) else place
        if str(host) not in ("127.0.0.1", "::1", "localhost", "") and not str(host).startswith("/"):
            raise SystemExit(f"the network was asked for {place}")
sys.addaudithook(refuse)
"""


def alone(code: str, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Python code in a process that reaches nobody else."""
    return subprocess.run(
        [sys.executable, "-c", LONELY + code, *arguments],
        cwd=ROOT,
        capture_output=True,
        text=True,
        env=os.environ | environment,
    )


def test_no_network_at_run_time(tmp_path):
    path = write_case(tmp_path, variants={"only": {}})
    arguments = ["run", str(path), "--out", str(tmp_path / "out"), "--no-movie", "--quiet"]
    run = alone("from pipeline.cli import main; sys.exit(main(sys.argv[1:]))", *arguments)
    assert run.returncode == 0, run.stderr
    assert (tmp_path / "out" / "beam" / "volume.png").exists()


@pytest.mark.parametrize("host", ["example.org", "192.0.2.1"])
def test_a_process_that_asks_for_the_network_is_caught(host):
    caught = alone(f"import socket; socket.create_connection(({host!r}, 80), timeout=1)")
    assert caught.returncode != 0 and "the network was asked for" in caught.stderr


def test_two_runs_in_one_session_are_the_same_bytes(tmp_path, monkeypatch):
    skip_figures(monkeypatch)
    case = load_case(write_case(tmp_path))
    one, two = (run_case(case, tmp_path / name, movie=False) for name in ("one", "two"))
    for a, b in zip(one.variants, two.variants, strict=True):
        assert_same_results(a.folder, b.folder)
        assert (a.folder / "statistics.nc").read_bytes() == (b.folder / "statistics.nc").read_bytes()
    assert (one.folder / "comparison.nc").read_bytes() == (two.folder / "comparison.nc").read_bytes()


@pytest.mark.slow
def test_one_and_two_threads_are_the_same_bytes(tmp_path):
    """By the solvers that cases get by themselves: banded for small meshes, warped for larger ones."""
    variants = {
        "linear": {"method.law": "linear"},
        "polar": {},
        "warped": {"method.linear_solver": "warped"},
        "converged": {"method.iterations": "converged"},
        "explicit": {"method.stepper": "symplectic_euler", "schedule.dt": 0.0001},
        "auto": {"method.model": "auto"},
    }
    mesh = {"shape": "box", "size": [1.0, 3.0, 1.0], "cells": [4, 12, 4]}
    path = write_case(tmp_path, mesh=mesh, variants=variants)
    code = "from pipeline.cli import main; sys.exit(main(sys.argv[1:]))"
    for threads in ("1", "2"):
        arguments = ["run", str(path), "--out", str(tmp_path / threads), "--no-movie", "--quiet"]
        names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
        run = alone(code, *arguments, **dict.fromkeys(names, threads))
        assert run.returncode == 0, run.stderr
    for name in variants:
        one, two = (tmp_path / threads / "beam" / name for threads in ("1", "2"))
        assert_same_results(one, two)
        assert (one / "statistics.nc").read_bytes() == (two / "statistics.nc").read_bytes(), name
