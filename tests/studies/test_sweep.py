"""Sweeps: results on disk as they come, resumed, lost workers, errors, and without dask.distributed."""

import json
import os
import signal
import threading
import time
from itertools import pairwise

import numpy as np
import pytest

from pipeline.errors import PipelineError, SolveError
from pipeline.results.lock import lock_folder
from pipeline.studies import sweep as sweep_module
from pipeline.studies.sweep import Point, run_sweep


def make_points(*numbers, **more):
    return [Point(f"point-{n}", {"number": n, **more}) for n in numbers]


def make_square_task():  # tasks are local, so that cloudpickle takes them to the workers by value
    return lambda settings: {"square": settings["number"] ** 2, "process": os.getpid()}


def test_points_are_computed_in_other_processes_and_written_to_files(tmp_path):
    seen = []
    results = run_sweep(
        make_square_task(), make_points(1, 2, 3), tmp_path, on_result=lambda p, done, total: seen.append((done, total))
    )
    assert {key: result["square"] for key, result in results.items()} == {"point-1": 1, "point-2": 4, "point-3": 9}
    assert list(results) == ["point-1", "point-2", "point-3"] and seen == [(1, 3), (2, 3), (3, 3)]
    assert os.getpid() not in {result["process"] for result in results.values()}
    for key, result in results.items():
        read = json.loads((tmp_path / f"points/{key}.json").read_text())
        assert read["result"] == result and read["settings"]["number"] ** 2 == result["square"]


@pytest.fixture
def here(monkeypatch):
    """No dask.distributed: everything runs in this process."""
    monkeypatch.setattr(sweep_module, "find_spec", lambda name: None)


def test_without_distributed_the_points_run_here_with_a_warning(tmp_path, here, caplog):
    results = run_sweep(make_square_task(), make_points(2, 3), tmp_path)
    assert [r["square"] for r in results.values()] == [4, 9] and results["point-2"]["process"] == os.getpid()
    assert "no dask.distributed" in caplog.text
    with pytest.raises(PipelineError, match="needs dask"):
        run_sweep(make_square_task(), make_points(4), tmp_path, scheduler="tcp://127.0.0.1:1")


def test_a_sweep_resumes(tmp_path, here):
    done = []

    def task(settings):
        if settings["number"] == 3 and len(done) < 3:
            raise KeyboardInterrupt
        done.append(settings["number"])
        return {"value": np.array([settings["number"], np.nan])}

    with pytest.raises(KeyboardInterrupt):
        run_sweep(task, make_points(1, 2, 3, 4), tmp_path)
    assert done == [1, 2]
    done.append("again")
    seen = []
    results = run_sweep(task, make_points(1, 2, 3, 4), tmp_path, on_result=lambda p, done, total: seen.append(done))
    assert done == [1, 2, "again", 3, 4] and seen == [1, 2, 3, 4]
    assert results["point-1"] == {"value": [1.0, None]} and list(results) == [
        "point-1",
        "point-2",
        "point-3",
        "point-4",
    ]


def test_points_with_other_settings_versions_or_torn_files_are_computed_again(tmp_path, here, monkeypatch):
    calls = []

    def task(settings):
        calls.append(dict(settings))
        return {}

    run_sweep(task, make_points(1, dt=0.1), tmp_path)
    run_sweep(task, make_points(1, dt=0.1), tmp_path)
    assert len(calls) == 1
    run_sweep(task, make_points(1, dt=0.2), tmp_path)
    assert len(calls) == 2
    monkeypatch.setattr(sweep_module, "VERSION", "another")
    run_sweep(task, make_points(1, dt=0.2), tmp_path)
    assert len(calls) == 3
    for torn in ('{"settings": {"num', "[]", '{"settings": {}}'):
        (tmp_path / "points/point-1.json").write_text(torn)
        run_sweep(task, make_points(1, dt=0.2), tmp_path)
    assert len(calls) == 6


def test_an_error_is_the_result_of_its_point(tmp_path, here):
    tried = []

    def task(settings):
        tried.append(settings["number"])
        raise SolveError("it blew up") if settings["number"] == 1 else ZeroDivisionError("a bug")

    for _ in range(2):
        results = run_sweep(task, make_points(1, 2), tmp_path)
        assert results["point-1"] == {"error": "SolveError: it blew up"}
        assert results["point-2"] == {"error": "ZeroDivisionError: a bug", "unexpected": True}
    assert tried == [1, 2, 2]  # an unexpected error is tried again


def test_two_sweeps_do_not_share_a_folder(tmp_path, here):
    with lock_folder(tmp_path), pytest.raises(PipelineError, match="another run"):
        run_sweep(make_square_task(), make_points(1), tmp_path)


@pytest.mark.parametrize(
    ("keys", "message"),
    [(["a", "a"], "twice"), (["a/b"], "cannot name"), ([""], "cannot name"), ([".."], "cannot name")],
)
def test_keys_must_be_unique_file_names(tmp_path, here, keys, message):
    with pytest.raises(PipelineError, match=message):
        run_sweep(make_square_task(), [Point(key, {}) for key in keys], tmp_path)


@pytest.mark.slow
def test_a_lost_worker_affects_only_its_task(tmp_path):
    marks = tmp_path / "marks"
    marks.mkdir()

    def task(settings):
        number = settings["number"]
        with open(marks / str(number), "a") as mark:
            mark.write(f"{os.getpid()}\n")
        if number == 2 and len((marks / "2").read_text().splitlines()) == 1:
            os.kill(os.getpid(), signal.SIGKILL)
        if number == 3:
            os.kill(os.getpid(), signal.SIGKILL)
        time.sleep(0.2)
        return {"number": number}

    results = run_sweep(task, make_points(1, 2, 3, 4, 5), tmp_path / "study")
    assert results["point-3"].pop("error").startswith("KilledWorker: ")
    assert results["point-3"] == {"unexpected": True}
    assert all(results[f"point-{n}"] == {"number": n} for n in (1, 2, 4, 5))
    assert len((marks / "2").read_text().splitlines()) > 1


@pytest.mark.slow
def test_a_worker_killed_from_outside_is_replaced_and_timed_points_run_one_at_a_time(tmp_path):
    marks = tmp_path / "marks"
    marks.mkdir()

    def task(settings):
        began = time.time()
        (marks / f"{settings['number']}").write_text(str(os.getpid()))
        time.sleep(0.5)
        return {"began": began, "ended": time.time(), "threads": os.environ["OMP_NUM_THREADS"]}

    def kill_the_second():
        while not (marks / "2").exists() or not (marks / "2").read_text():
            time.sleep(0.01)
        os.kill(int((marks / "2").read_text()), signal.SIGKILL)

    killer = threading.Thread(target=kill_the_second)
    killer.start()
    results = run_sweep(task, make_points(1, 2, 3), tmp_path, timed=True)
    killer.join()
    spans = sorted((r["began"], r["ended"]) for r in results.values())
    assert len(spans) == 3 and all(a[1] <= b[0] for a, b in pairwise(spans))
    assert {r["threads"] for r in results.values()} == {"1"}


@pytest.mark.slow
def test_an_existing_scheduler_is_used_and_keeps_running(tmp_path):
    from distributed import Client, LocalCluster

    with LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None) as cluster:
        results = run_sweep(make_square_task(), make_points(5), tmp_path, scheduler=cluster.scheduler_address)
        assert results["point-5"] == {"square": 25, "process": os.getpid()}
        with Client(cluster) as client:
            assert len(client.scheduler_info()["workers"]) == 1


def test_a_missing_scheduler_is_an_error_of_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(sweep_module, "_CONNECT_SECONDS", 0.3)
    for address in ("tcp://127.0.0.1:1", "nonsense://x"):
        with pytest.raises(PipelineError, match="does not answer") as raised:
            run_sweep(make_square_task(), make_points(1), tmp_path, scheduler=address)
        assert "\n" not in str(raised.value)
