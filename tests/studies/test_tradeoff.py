"""The trade-off study: settings, deviations from known motions, fronts, the choice, and all of it on a small beam."""

import json
from dataclasses import replace
from functools import wraps
from types import SimpleNamespace

import numpy as np
import pytest
import tomli_w
import xarray

from pipeline.case import load_case
from pipeline.cli import main
from pipeline.errors import CaseError, SolveError
from pipeline.mesh.quadratic import raise_order
from pipeline.mesh.shapes import box, rectangle
from pipeline.problem.problem import build, build_mesh
from pipeline.studies import sweep as sweep_module
from pipeline.studies.tradeoff.chosen_variant import write_chosen_variant
from pipeline.studies.tradeoff.deviation import (
    FirstMode,
    combine_error,
    find_first_mode,
    measure_deviation,
    measure_distances,
)
from pipeline.studies.tradeoff.finest_error import estimate_finest_error
from pipeline.studies.tradeoff.levels import MeshLevel, match_nodes
from pipeline.studies.tradeoff.mode_steps import find_steps_per_period
from pipeline.studies.tradeoff.motion import (
    RecordedMotion,
    make_task_settings,
    pack_array,
    read_motion,
    run_motion,
    run_race,
    unpack_array,
)
from pipeline.studies.tradeoff.orders import _extrapolate, describe_orders, list_goals
from pipeline.studies.tradeoff.settings import (
    AUTO,
    CONVERGED,
    LINEAR,
    Setting,
    make_plan,
    make_point_case,
)
from pipeline.studies.tradeoff.study import study_tradeoff
from pipeline.studies.tradeoff.table import ErrorTable, SettingRow
from pipeline.studies.tradeoff.verdict import (
    describe_choice,
    describe_finest_error,
    find_cheapest,
    find_front,
    judge_auto,
    split_error,
)
from tests.bodies import PLANAR, assert_conventional, case_document, make_clamped_bar, write_case


@pytest.fixture(scope="module", autouse=True)
def here():
    """No dask.distributed: every point runs in this process; tests/studies/test_sweep.py has the cluster."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sweep_module, "find_spec", lambda name: None)
        patch.setattr("pipeline.studies.tradeoff.motion._LEAST_SECONDS", 0.0)  # no test depends on seconds
        patch.setattr("pipeline.studies.tradeoff.motion._PAIRS", 1)
        yield


OWN = MeshLevel(1.0, 1)


def make_small_plan(folder, *, sections=None, **keywords):
    case = load_case(write_case(folder, **(sections or {})))
    return make_plan(case, **{"tolerance": 0.01, "quick": True, **keywords})


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """The quick study of a soft beam of 18 tetrahedra, with one finer mesh."""
    folder = tmp_path_factory.mktemp("study")
    plan = make_small_plan(folder, refinements=[1, 2], tolerance=0.02)
    return plan, study_tradeoff(plan, folder / "out", repeats=1)


# settings


def test_every_stepper_and_step_has_every_model(tmp_path):
    plan = make_small_plan(tmp_path, quick=False)
    assert plan.dts == (0.04, 0.02, 0.01, 0.005, 0.0025) and plan.dt == 0.02
    assert plan.levels == (OWN, MeshLevel(2, 1), MeshLevel(1, 2), MeshLevel(2, 2)) and plan.finest.order == 2
    assert plan.interval == 0.04 and plan.frames == 2
    assert len({setting.key for setting in plan.settings}) == len(plan.settings)
    for stepper in ("backward_euler", "bdf2"):
        for dt in plan.dts:
            alike = [s for s in plan.settings if (s.level, s.stepper, s.dt, s.mass) == (OWN, stepper, dt, "consistent")]
            assert {s.model for s in alike} == {
                "linear", "auto", "polar-1", "polar-2", "polar-3", "polar-converged", "gram_schmidt-1",
            }  # fmt: skip
    assert plan.make_reference(OWN).dt == 0.0025 / 8 and plan.make_coarser_reference(OWN) in plan.settings
    assert {s.mass for s in plan.settings if s.stepper == "bdf2"} == {"consistent", "lumped"}
    assert plan.case_setting == Setting(1, 1, "consistent", "backward_euler", 0.02, "corotational", "polar", "1")


def test_every_setting_is_a_case_with_frames_at_the_same_instants(tmp_path):
    plan = make_small_plan(tmp_path, refinements=[1, 2], orders=[1, 2])
    assert len(plan.levels) == 4
    for setting in plan.settings:
        case = make_point_case(plan, setting)
        schedule = case.schedule
        assert schedule.dt * schedule.steps_per_frame == pytest.approx(plan.interval, rel=1e-12)
        assert schedule.frames == plan.frames and case.method.mass == setting.mass
        assert case.mesh.cells == tuple(setting.refinement * c for c in (1, 3, 1))
        assert case.mesh.order == setting.order
        build(case)  # explicit steps below their limit, names that go together


def test_implicit_steps_for_an_explicit_case_are_its_frame_interval(tmp_path):
    schedule = {"dt": 1e-4, "steps_per_frame": 100, "frames": 8}
    method = {"stepper": "symplectic_euler", "mass": "lumped"}
    plan = make_small_plan(tmp_path, sections={"schedule": schedule, "method": method, **PLANAR})
    assert plan.dt == 0.01 and plan.case_setting.stepper == "bdf2" and plan.case_setting.mass == "lumped"


def test_a_long_run_is_compared_at_fifty_instants_at_most(tmp_path):
    plan = make_small_plan(tmp_path, sections={"schedule": {"dt": 0.02, "frames": 1001}})
    assert plan.frames <= 50 and plan.interval == pytest.approx(0.02 * 21)


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"dts": [0.02, 0.015]}, "does not divide"),
        ({"dts": [-0.02]}, "not a positive"),
        ({"dts": [float("nan")]}, "not a positive"),
        ({"dts": [1.0]}, "shorter than"),
        ({"refinements": [0]}, "positive numbers"),
        ({"refinements": [0.5]}, "1 cells times 0.5 is not a whole number"),
        ({"orders": [3]}, "--order 3: orders are 1 and 2"),
        ({"steps": 0}, "shorter than"),
    ],
)
def test_steps_and_refinements_that_do_not_fit_are_errors(tmp_path, keywords, message):
    with pytest.raises(CaseError, match=message):
        make_small_plan(tmp_path, **keywords)


def test_a_mesh_that_cannot_be_refined_has_a_note(tmp_path, cases_folder):
    by_node = make_small_plan(tmp_path, sections={"supports": [{"nodes": [0, 1, 2, 3]}]}, refinements=[1, 2])
    alone = make_small_plan(tmp_path)
    for plan, reason in ((by_node, "names nodes"), (alone, "one mesh only")):
        assert plan.levels == (OWN,) and reason in plan.notes[0] and "mesh error not available" in plan.notes[0]


def test_the_mesh_of_a_file_is_refined_by_cutting_its_cells(cases_folder):
    case = load_case(cases_folder / "mushroom.toml")
    plan = make_plan(case, quick=True, refinements=[1, 2], orders=[2], steps=2)
    assert plan.levels == (OWN, MeshLevel(1, 2), MeshLevel(2, 2))
    meshes = [build_mesh(make_point_case(plan, plan.make_reference(level))) for level in plan.levels]
    assert [len(mesh.cells) for mesh in meshes] == [656, 656, 8 * 656]
    nodes, partners = match_nodes(meshes[0], meshes[2])
    assert (nodes == np.arange(219)).all() and (partners == nodes).all()
    with pytest.raises(CaseError, match=r"mesh.file: --refine 3: .* factors are 1, 2, 4"):
        make_plan(case, refinements=[3])


@pytest.mark.parametrize(
    ("loads", "reason"),
    [
        ({"point": [{"nodes": [3], "force": [0.0, 0.0, 1.0]}]}, "loads.point.0.nodes names nodes"),
        ({"point": [{"plane": "y", "at": 3.0, "force": [0.0, 0.0, 1.0]}]}, "acts on each selected node"),
        ({"point": [{"at": [0.5, 1.5, 0.5], "force": [0.0, 0.0, 1.0]}]}, None),
    ],
)
def test_loads_that_belong_to_nodes_are_another_scene_on_another_mesh(tmp_path, loads, reason):
    plan = make_small_plan(tmp_path, sections={"loads": loads}, orders=[1, 2])
    assert plan.levels == ((OWN,) if reason else (OWN, MeshLevel(1, 2)))
    assert reason is None or reason in plan.notes[0]


@pytest.mark.parametrize(("shape", "size", "cells"), [(box, (1, 3, 2), (1, 3, 2)), (rectangle, (2, 1), (3, 2))])
def test_coarse_nodes_are_found_in_finer_meshes(shape, size, cells):
    coarse = shape(size, cells)
    for mesh in (coarse, raise_order(coarse)):
        for fine in (shape(size, [3 * c for c in cells]), raise_order(shape(size, [2 * c for c in cells]))):
            nodes, partners = match_nodes(mesh, fine)
            assert np.isin(np.arange(len(coarse.points)), nodes).all()
            np.testing.assert_allclose(fine.points[partners], mesh.points[nodes], atol=1e-12)
    with pytest.raises(SolveError, match="corners of its cells are no nodes"):
        match_nodes(coarse, shape(size, [3 * c + 1 for c in cells]))


@pytest.mark.parametrize("rate", [1.0, 1.5, 2.0, 3.0])
def test_the_error_of_the_finest_mesh_follows_the_observed_rate(rate):
    coarse, half, finest = (0.3 * size**rate for size in (4, 2, 1))
    found = estimate_finest_error(2, [half - finest, coarse - finest])
    assert found.is_observed and found.error == pytest.approx(finest) and found.rate == pytest.approx(rate)
    assert f"size^{rate:.1f} (as observed)" in describe_finest_error(found)


def test_two_meshes_show_no_rate_so_that_a_slow_one_is_assumed():
    first, second = (estimate_finest_error(order, [0.1, float("nan")]) for order in (1, 2))
    assert first.error == pytest.approx(0.1) and second.error == pytest.approx(0.1 / (2**1.5 - 1))
    assert "assumed" in describe_finest_error(second) and not second.is_observed
    assert estimate_finest_error(2, [float("nan"), 0.5]) is None
    assert estimate_finest_error(1, [0.0, 0.0]).error == 0.0


@pytest.mark.parametrize("distances", [(0.5, 0.5), (0.5, 0.4), (0.4, 0.9)])
def test_no_error_is_named_if_the_meshes_do_not_converge(distances):
    found = estimate_finest_error(1, distances)
    assert found.error is None and found.rate is None
    assert "is unknown" in describe_finest_error(found) and "no convergence" in describe_finest_error(found)


def measure_meshes(case, **keywords):
    """Return a table with the references of a plan alone."""
    plan = make_plan(case, quick=True, **keywords)
    plan = replace(plan, settings=tuple(map(plan.make_reference, plan.levels)))
    results = {s.key: run_motion(make_task_settings(make_point_case(plan, s), 1)) for s in plan.settings}
    return ErrorTable(plan, results)


@pytest.mark.slow
def test_the_named_error_of_the_finest_mesh_is_near_the_true_one(cases_folder):
    """Half the cells' size of bar_as_printed is off by half of the body's size: its error was once named a sixth."""
    case = load_case(cases_folder / "bar_as_printed.toml")
    keywords = {"dts": [0.07], "steps": 15, "tolerance": 0.01}
    linear = measure_meshes(case, refinements=[1, 2], orders=[1], **keywords)
    named = linear.estimate_reference_errors().mesh
    both = measure_meshes(case, refinements=[1, 2], orders=[1, 2], **keywords)
    true = both.find_mesh_error(MeshLevel(2, 1))
    assert 0.5 < named / true < 2.0
    # and order 2 is in the asymptotic range: its finest mesh has an error of a few per cent at most
    assert both.estimate_reference_errors().mesh < 0.03 < true


def test_costs_at_five_and_one_per_cent_are_told_for_both_orders(tmp_path, monkeypatch):
    plan = SimpleNamespace(levels=(OWN, MeshLevel(1, 2)), tolerance=0.02)
    rows = {1: make_row(4.0, 0.04), 2: make_row(0.5, 0.008)}
    rows = {n: replace(row, setting=replace(row.setting, order=n)) for n, row in rows.items()}
    rows = {n: replace(row, deviations={"total_worst_distance": (0.04, 0.008)[n - 1]}) for n, row in rows.items()}
    finest, errors = estimate_finest_error(2, [0.004, float("nan")]), {1: 0.03, 2: 0.004}
    table = SimpleNamespace(
        plan=plan,
        find_mesh_error=lambda level: errors[level.order],
        estimate_reference_errors=lambda: SimpleNamespace(finest=finest),
    )
    monkeypatch.setattr(
        "pipeline.studies.tradeoff.orders.list_choosable", lambda table, levels: [rows[levels[0].order]]
    )
    assert list_goals(0.02) == [0.05, 0.02, 0.01]
    five, one = (describe_orders(table, goal) for goal in (0.05, 0.01))
    assert five.startswith("5 % in total: order 1 4e+03 ms (bdf2, the linear law, consistent mass, order 1, dt")
    assert five.endswith("order 1 costs 8 times as much")
    assert "order 1 not reached" in one and "order 2 500 ms" in one and "times as much" not in one
    errors[2] = 0.02  # an error of time that makes up for the mesh's is no accuracy
    assert "order 2 not reached" in describe_orders(table, 0.01)
    finest = estimate_finest_error(2, [0.5, 0.5])
    assert "not known to be that accurate" in describe_orders(table, 0.05)


def test_costs_are_extrapolated_along_the_line_through_two_meshes():
    assert _extrapolate([(0.4, 1.0), (0.1, 10.0)], 0.025) == pytest.approx(100.0)
    for points in ([(0.4, 1.0), (0.3, 20.0)], [(0.1, 1.0)], [(0.1, 1.0), (0.1, 9.0)], [(0.4, 2.0), (0.1, 1.0)]):
        assert _extrapolate(points, 0.01) == np.inf


# deviations


def make_motion(mesh, u, v=None, energy=1.0):
    level = np.full(len(u), energy)
    return RecordedMotion(mesh, u, np.zeros_like(u) if v is None else v, level, level)


def test_deviations_of_known_motions():
    mesh = box((1.0, 2.0, 2.0), (1, 2, 2))  # its size is 3
    still = make_motion(mesh, np.zeros((2, *mesh.points.shape)))
    moved = still.u.copy()
    moved[1] += [0.0, 0.3, 0.0]
    found = measure_deviation(make_motion(mesh, moved, energy=1.5), still, None)
    assert found["worst_distance"] == pytest.approx(0.1) and found["rms_distance"] == pytest.approx(0.1 / 2**0.5)
    assert found["volume"] < 1e-12 and found["drift"] < 1e-12 and found["energy"] == pytest.approx(0.5)
    grown = make_motion(mesh, np.stack([0 * mesh.points, 0.1 * mesh.points]))
    found = measure_deviation(grown, still, None)
    assert found["volume"] == pytest.approx(1.1**3 - 1) and found["drift"] == pytest.approx(1.1**3 - 1)
    assert combine_error(found) == pytest.approx(0.5 * (1.1**3 - 1)) and np.isnan(found["mode_phase"])
    some = np.array([0, 5])
    assert measure_distances(make_motion(mesh, moved), still, (np.arange(len(mesh.points)),) * 2)[
        "worst_distance"
    ] == pytest.approx(0.1)
    with pytest.raises(ValueError):
        measure_distances(make_motion(mesh, moved), still, (some, some[:1].repeat(3)))


def test_amplitude_and_phase_of_the_first_mode():
    body = make_clamped_bar()
    mode = find_first_mode(body)
    assert isinstance(mode, FirstMode) and mode.omega == pytest.approx(10.424, rel=1e-3)
    shape = np.zeros_like(body.mesh.points)
    t = np.linspace(0, 2, 40)
    from pipeline.fem.modes import find_lowest_frequencies

    shape = find_lowest_frequencies(body)[1][0]

    def swinging(size, late):
        angle = mode.omega * t - late
        u, v = size * np.cos(angle), -size * mode.omega * np.sin(angle)
        return make_motion(body.mesh, u[:, None, None] * shape, v[:, None, None] * shape)

    found = measure_deviation(swinging(0.9, np.radians(5)), swinging(1.0, 0.0), mode)
    assert found["mode_amplitude"] == pytest.approx(0.1) and found["mode_phase"] == pytest.approx(5.0)


def test_motions_survive_packing():
    values = np.random.default_rng(0).standard_normal((3, 4, 2)) * 1e-3
    np.testing.assert_allclose(unpack_array(pack_array(values), (3, 4, 2)), values, rtol=1e-7)


def test_a_run_in_memory_equals_the_frames(tmp_path):
    from pipeline.run.frame_iterator import frames

    plan = make_small_plan(tmp_path)
    case = make_point_case(plan, plan.case_setting)
    result = run_motion(json.loads(json.dumps(make_task_settings(case, 2))))
    problem = build(case)
    seen = list(frames(problem))
    motion = read_motion(result, problem.body.mesh)
    np.testing.assert_allclose(motion.u[-1], seen[-1].x - problem.body.mesh.points, rtol=1e-6, atol=1e-9)
    assert result["work"]["steps"] == plan.frames == 4 and result["repeats"] >= 2
    assert motion.drift[-1] == pytest.approx(
        motion.ratios[-1] @ motion.mesh.rest_volumes / motion.mesh.rest_volumes.sum() - 1
    )


def test_a_body_that_leaves_the_scene_is_an_error(tmp_path):
    plan = make_small_plan(tmp_path, sections={"supports": None, "initial": {"velocity": [0.0, 0.0, 1e6]}})
    with pytest.raises(SolveError, match="times its size"):
        run_motion(make_task_settings(make_point_case(plan, plan.case_setting), 1))


def test_a_race_of_a_case_with_itself(tmp_path):
    plan = make_small_plan(tmp_path)
    settings = make_task_settings(make_point_case(plan, plan.case_setting), 1)
    found = run_race(settings | {"rival": settings["case"]})
    assert found["ratio"] > 0 and found["pairs"] == 1


# verdicts


def make_row(seconds, worst, volume=0.0, *, model=LINEAR, dt=0.1, model_volume=0.0):
    costs = {
        "seconds": seconds,
        "newton_iterations": 1.0,
        "seconds_per_step": seconds / 10,
        "real_time_factor": 1 / seconds,
    }
    found = {"motion_worst_distance": worst, "motion_volume": volume, "model_worst_distance": 0.0}
    setting = Setting(1, 1, "consistent", "bdf2", dt, *model)
    return SettingRow(setting, costs, found | {"model_volume": model_volume})


def test_the_front_has_the_rows_that_no_other_beats():
    rows = [make_row(1, 0.5), make_row(2, 0.1), make_row(2.5, 0.2), make_row(3, 0.1), make_row(4, 0.0, volume=0.04)]
    assert find_front([*rows, SettingRow(rows[0].setting, failure="SolveError")]) == [rows[0], rows[1], rows[4]]
    assert (
        find_cheapest(rows, 0.1) is rows[1]
        and find_cheapest(rows, 0.02) is rows[4]
        and find_cheapest(rows, 0.01) is None
    )


def test_the_most_accurate_of_equally_fast_settings_is_chosen():
    rows = [make_row(1.0, 0.5), make_row(1.05, 0.1), make_row(1.08, 0.3), make_row(1.2, 0.0)]
    assert find_cheapest(rows, 0.5) is rows[1] and find_cheapest(rows[2:], 0.5) is rows[2]
    by_axes = make_row(1.0, 0.05, model=("corotational", "gram_schmidt", "1"))
    assert find_cheapest([by_axes, *rows], 0.5) is rows[1] and find_cheapest([by_axes], 0.5) is by_axes


def test_auto_is_compared_with_the_cheapest_setting_of_its_tolerance():
    rows = [
        make_row(1, 0.0, model_volume=0.05),
        make_row(2, 0.0, model=("corotational", "polar", "1"), model_volume=0.01),
        make_row(3, 0.0, model=CONVERGED),
        make_row(2.2, 0.0, model=AUTO, model_volume=0.015),
        make_row(1.5, 0.0, model=CONVERGED, dt=0.2),
    ]
    (found,) = judge_auto(SimpleNamespace(rows=rows, plan=SimpleNamespace(tolerance=0.01)))
    assert found.rival == rows[1].setting and found.ratio == pytest.approx(1.1) and found.is_within
    rows[1] = make_row(
        2, 0.0, model=("corotational", "polar", "1"), model_volume=0.012
    )  # twice the tolerance is not it
    rows[3] = make_row(2.2, 0.0, model=AUTO, model_volume=0.009)
    (found,) = judge_auto(SimpleNamespace(rows=rows, plan=SimpleNamespace(tolerance=0.01)))
    assert found.rival == rows[2].setting
    rows[3] = make_row(2.2, 0.0, model=AUTO, model_volume=0.021)
    assert not judge_auto(SimpleNamespace(rows=rows, plan=SimpleNamespace(tolerance=0.01)))[0].is_within


def test_the_sentence_respects_the_accuracy_of_the_reference():
    rows = [make_row(1, 0.005), make_row(3, 0.0005, dt=0.05)]
    plan = SimpleNamespace(
        tolerance=0.01,
        levels=(OWN,),
        own=OWN,
        finest=OWN,
        case=SimpleNamespace(name="scene"),
        make_reference=lambda level: None,
    )

    def describe(sure, rows=rows, mesh=float("nan")):
        reference = SimpleNamespace(time=sure)
        table = SimpleNamespace(
            plan=plan, rows=rows, find_mesh_error=lambda r: mesh, estimate_reference_errors=lambda: reference
        )
        return describe_choice(table)

    assert describe(1e-4).startswith(
        "scene: for 1 % use bdf2, the linear law, consistent mass, order 1, dt = 0.1 s: 100 ms a step"
    )
    assert "0.1 % costs 3 times as much" in describe(1e-4) and "reference" not in describe(1e-4)
    assert "0.1 % was not reached (0.5 % by" in describe(1e-4, rows[:1])
    assert "0.1 % is below the accuracy of the reference; the reference itself has an error of 2 %" in describe(0.02)
    assert describe(1e-4, [make_row(1, 0.05)]).startswith("scene: no setting that was run reaches 1 % (5 % by bdf2")
    assert describe(1e-4, mesh=0.3).endswith("the mesh itself differs by 30 % from cells x 1 of order 1")


@pytest.mark.parametrize("stepper", ["backward_euler", "bdf2"])
def test_steps_per_period_agree_with_the_formula(tmp_path, stepper):
    plan = make_small_plan(tmp_path)
    case = make_point_case(plan, Setting(1, 1, "consistent", stepper, 0.02, *LINEAR))
    found = find_steps_per_period(make_task_settings(case, 1) | {"tolerance": 0.02})
    n = np.arange(1, 3000)
    z = 2 * np.pi / n
    # for bdf2 the larger root of 3/2 - 2/G + 1/(2 G^2) = i z
    one = 1 / (1 - 1j * z) if stepper == "backward_euler" else 1 / (2 - np.sqrt(1 + 2j * z))
    # z + i dq/dt / omega turns clockwise: its factor a step is the conjugate
    exact = np.flatnonzero(np.abs(one**n - 1) <= 0.02)
    first = int(n[exact[exact > 3][0]])
    assert found["steps"] == pytest.approx(first, rel=0.02, abs=2) and found["error"] <= 0.02


# the whole


@pytest.mark.slow
def test_the_study_is_written_to_files(study):
    plan, found = study
    with xarray.open_dataset(found.folder / "tradeoff.nc") as dataset:
        assert_conventional(dataset)
        knobs = {"refinement", "order", "mass", "stepper", "dt", "law", "rotation", "iterations"}
        assert set(dataset.seconds.dims) == knobs
        assert int(dataset.seconds.notnull().sum()) == len(plan.settings) and float(dataset.failed.max()) == 0
        case = {"refinement": 1, "order": 1, "mass": "consistent", "stepper": "bdf2", "dt": 0.01}
        auto = dataset.sel(**case, law="auto", rotation="none", iterations="none")
        assert float(auto.model_volume) <= 0.04 and float(auto.steps) == 8
        converged = dataset.sel(**case, law="corotational", rotation="polar", iterations="converged")
        assert float(converged.model_worst_distance) == 0.0 < float(converged.motion_worst_distance)
        assert np.isnan(dataset.seconds.sel(**case, law="linear", rotation="polar", iterations="1"))
        assert float(dataset.total_worst_distance.sel(refinement=2).min()) == 0.0
        assert float(dataset.total_drift.sel(refinement=2).min()) == 0.0 < float(dataset.total_drift.max())
    summary = json.loads((found.folder / "summary.json").read_text())
    assert summary["sentence"] == found.sentence and summary["failed"] == {}
    assert summary["first_mode"]["fewer"] > 10
    assert all(verdict["is_within"] and verdict["ratio"] > 0 for verdict in summary["auto"])
    assert (found.folder / "tradeoff.png").stat().st_size > 10_000


@pytest.mark.slow
def test_the_reference_is_more_accurate_than_the_rows(study):
    _, found = study
    own = found.summary["reference"]
    assert 0 < own["time"] < 5e-3 and 0.5 < own["order"] < 2.5
    parts = found.summary["own_error_parts"]
    assert parts["dominant"] == max(("model", "dt", "mesh"), key=lambda name: parts[name])
    assert parts["mesh"] > 0.01  # 18 tetrahedra are stiff in bending
    assert 0 < own["mesh"] == pytest.approx(parts["mesh"])  # of one coarser mesh, if errors fall as the cells' size


def read_seconds(row) -> float:
    return row["costs"]["seconds"]


@pytest.mark.slow
def test_the_sentence_names_a_setting_within_the_tolerance(study):
    plan, found = study
    choice = found.summary["choice"]
    assert choice["error"] <= plan.tolerance and choice["text"] in found.sentence
    assert found.sentence.startswith("beam: for 2 % use ") and "0.2 %" in found.sentence
    # the front holds the cheapest that is enough; the choice may cost a tenth more where it is more accurate
    least = min((one for one in found.summary["front"] if one["error"] <= plan.tolerance), key=read_seconds)
    assert read_seconds(least) <= read_seconds(choice) <= 1.1 * read_seconds(least)
    assert choice["error"] <= least["error"] or least["setting"]["rotation"] == "gram_schmidt"


@pytest.mark.slow
def test_a_finished_study_is_not_run_again(study, monkeypatch):
    plan, found = study
    monkeypatch.setattr("pipeline.studies.tradeoff.study.run_motion", lambda settings: pytest.fail("run again"))
    again = study_tradeoff(plan, found.folder, repeats=1)
    assert again.summary == found.summary


@pytest.mark.slow
def test_a_failed_reference_is_an_error_and_other_failures_are_rows(study):
    plan, found = study
    results = {s.key: json.loads((found.folder / f"points/{s.key}.json").read_text())["result"] for s in plan.settings}
    broken = plan.settings[7].key
    table = ErrorTable(plan, results | {broken: {"error": "SolveError: blew up"}})
    assert [one.failure for one in table.rows if one.setting.key == broken] == ["SolveError: blew up"]
    assert "use" in describe_choice(table) or "no setting" in describe_choice(table)
    assert split_error(table, table.find_row(plan.case_setting)).dominant in ("model", "dt", "mesh")
    with pytest.raises(SolveError, match="no reference with cells x 2 of order 1: SolveError: blew up"):
        ErrorTable(plan, results | {plan.make_reference(MeshLevel(2, 1)).key: {"error": "SolveError: blew up"}})


# the choice as a variant

CHOSEN = Setting(1, 1, "lumped", "bdf2", 0.01, *AUTO)


def test_the_choice_becomes_a_variant_and_the_rest_of_the_file_is_kept(tmp_path):
    path = write_case(tmp_path)
    plan = make_plan(load_case(path), tolerance=0.01, quick=True, steps=2)
    assert plan.frames == 2
    path.write_text(path.read_text() + "\n# a last remark\n")
    before = path.read_text()
    write_chosen_variant(plan, CHOSEN, "for 1 % it is enough")
    text = path.read_text()
    assert text.startswith(before) and "# for 1 % it is enough" in text
    case = load_case(path)
    assert case.variant_names == ("linear", "gram_schmidt", "polar", "adequate")
    chosen = case.variant("adequate")
    assert (chosen.method.model, chosen.method.stepper, chosen.method.mass) == ("auto", "bdf2", "lumped")
    assert (chosen.schedule.dt, chosen.schedule.steps_per_frame, chosen.schedule.frames) == (0.01, 2, 4)
    write_chosen_variant(plan, replace(CHOSEN, dt=0.04, refinement=2), "another reason")
    text = path.read_text()
    assert text.startswith(before) and text.count("adequate]") == 1 and "another reason" in text
    chosen = load_case(path).variant("adequate")
    assert (chosen.schedule.dt, chosen.schedule.steps_per_frame, chosen.schedule.frames) == (0.04, 1, 2)
    assert build_mesh(chosen).cells.shape[0] == 8 * 18


def test_a_case_without_variants_keeps_its_default(tmp_path):
    plan = make_small_plan(tmp_path, sections={"variants": None})
    write_chosen_variant(plan, CHOSEN, "why")
    assert load_case(plan.case.path).variant_names == ("default", "adequate")
    write_chosen_variant(plan, CHOSEN, "why not")
    assert load_case(plan.case.path).variant_names == ("default", "adequate")


def test_a_file_that_cannot_have_the_variant_is_unchanged(tmp_path):
    own = make_small_plan(tmp_path, sections={"variants": {"adequate": {}}})
    inline = load_case(write_case(tmp_path, "inline.toml", variants=None))
    inline.path.write_text(f"variants = {{polar = {{}}}}\n{inline.path.read_text()}")
    for plan, message in ((own, "exists already"), (make_plan(inline, tolerance=0.1), "cannot be appended")):
        before = plan.case.path.read_text()
        with pytest.raises(CaseError, match=message) as raised:
            write_chosen_variant(plan, CHOSEN, "why")
        assert plan.case.path.read_text() == before and "\n" not in str(raised.value)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["beam.toml", "inline.toml"]


# the command line


@pytest.mark.slow
def test_the_command_prints_the_sentence_and_writes_the_variant(tmp_path, capsys):
    path = write_case(tmp_path, **PLANAR, schedule={"dt": 0.02, "frames": 2})
    arguments = ["study", "tradeoff", str(path), "--quick", "--repeats", "1", "--tolerance", "0.3"]
    assert main([*arguments, "--apply", "--out", str(tmp_path / "out")]) == 0
    out, _ = capsys.readouterr()
    assert out.startswith("beam: for 30 % use ") and "its own error is about" in out and "tradeoff.nc" in out
    assert 'variant "adequate" written' in out and "adequate" in load_case(path).variant_names
    assert main([*arguments, "--quiet", "--out", str(tmp_path / "out")]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--tolerance", "0"], "--tolerance"),
        (["--tolerance", "nan"], "--tolerance"),
        (["--repeats", "0"], "--repeats"),
        (["--dt", "0.02", "0.013"], "--dt"),
        (["--refine", "0"], "--refine"),
        (["--refine", "2", "3"], "--refine 2 does not divide 3"),
        (["--set", "method.stepper=rk4"], "rk4"),
        (["--scheduler", "tcp://127.0.0.1:1"], "scheduler"),
        (["--apply", "--set", "schedule.dt=0.01"], "for another case"),
        (["--apply", "--steps", "2"], "for the beginning"),
    ],
)
def test_wrong_input_is_one_line_and_exit_code_2(tmp_path, capsys, arguments, message):
    path = write_case(tmp_path)
    assert main(["study", "tradeoff", str(path), "--quiet", "--out", str(tmp_path / "o"), *arguments]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and message in lines[0]


def test_two_cases_of_one_name_are_refused(tmp_path, capsys):
    paths = [str(write_case(tmp_path, name)) for name in ("one.toml", "two.toml")]
    assert main(["study", "tradeoff", *paths, "--out", str(tmp_path / "o")]) == 2
    assert "name of another case" in capsys.readouterr().err


def test_a_case_without_a_reference_does_not_stop_the_others(tmp_path, capsys, monkeypatch):
    from pipeline.studies.tradeoff import study as module

    @wraps(module.study_tradeoff)
    def fail_if_bad(plan, folder, **keywords):
        if plan.case.name == "bad":
            raise SolveError("no reference")
        return module.Tradeoff(folder, None, {}, "good: use this", (), ())

    monkeypatch.setattr(module, "study_tradeoff", fail_if_bad)
    paths = [tmp_path / "bad.toml", tmp_path / "good.toml"]
    for path in paths:
        path.write_text(tomli_w.dumps(case_document(name=path.stem)))
    assert main(["study", "tradeoff", *map(str, paths), "--out", str(tmp_path / "o")]) == 3
    captured = capsys.readouterr()
    assert captured.out.startswith("good: use this") and captured.err == "SolveError: no reference\n"


def test_an_interrupted_study_says_how_to_continue(tmp_path, capsys, monkeypatch):
    @wraps(study_tradeoff)
    def interrupt(*arguments, **keywords):
        raise KeyboardInterrupt

    monkeypatch.setattr("pipeline.studies.tradeoff.study.study_tradeoff", interrupt)
    assert main(["study", "tradeoff", str(write_case(tmp_path)), "--quiet", "--out", str(tmp_path / "o")]) == 130
    assert capsys.readouterr().err == "interrupted; the same command continues from the points that are done\n"


def test_a_missing_case_and_an_unknown_study_are_errors(tmp_path, capsys):
    assert main(["study", "tradeoff", str(tmp_path / "none.toml")]) == 2
    assert "no such file" in capsys.readouterr().err
    with pytest.raises(SystemExit) as raised:
        main(["study", "nonsense"])
    assert raised.value.code == 2 and "tradeoff" in capsys.readouterr().err
