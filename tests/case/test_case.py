"""Case files: what is accepted, what comes back, and every message that a user can meet, word for word."""

import ast
import copy
import os
import pickle
import shutil
import tomllib
from pathlib import Path

import pytest
import tomli_w
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

import pipeline.case
from pipeline.case import Case, load_case, parse_override
from pipeline.errors import CaseError

CASES = sorted(Path(__file__).parents[2].glob("cases/*.toml"))
SMALL = {
    "name": "beam",
    "mesh": {"shape": "box", "size": [4.0, 12.0, 4.0], "cells": [2, 8, 2]},
    "material": {"youngs_modulus": 1.0e8, "poisson_ratio": 0.33, "density": 1000.0},
    "supports": [{"plane": "y", "at": 12.0}],
    "schedule": {"dt": 0.07, "frames": 100},
    "variants": {"linear": {"method.law": "linear"}, "polar": {}},
}


@pytest.fixture(autouse=True)
def _inside_a_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def write(document, name="beam.toml"):
    Path(name).write_text(tomli_w.dumps(document), encoding="utf-8")
    return name


def load(overrides=None, document=SMALL, **keywords) -> Case:
    return load_case(write(document), overrides=overrides, **keywords)


def message(overrides=None, document=SMALL, **keywords) -> str:
    with pytest.raises(CaseError) as caught:
        load(overrides, document, **keywords)
    text = str(caught.value)
    assert "\n" not in text and "http" not in text
    return text


# What comes back


@pytest.mark.parametrize("path", CASES, ids=lambda path: path.stem)
def test_every_case_file_loads_and_survives_a_round_trip(path):
    case = load_case(path)
    assert case.name == path.stem
    for name in case.variant_names:
        resolved = case.variant(name)
        Path("again.toml").write_text(resolved.to_toml("."), encoding="utf-8")
        again = load_case("again.toml")
        assert again.to_toml(".") == resolved.to_toml(".")
        assert again.variant_names == ("default",)


SEEDS = [path for path in CASES if path.stem.startswith("bar") and "quadratic" not in path.stem]


@pytest.mark.parametrize("path", SEEDS, ids=lambda path: path.stem)
def test_bar_scenes_are_those_of_the_seeds(path):
    case = load_case(path)
    assert case.variant_names == ("linear", "gram_schmidt", "polar", "converged")
    assert case.movie.variants == ("linear", "polar")
    assert case.initial.velocity == (0.0, 0.0, -20.0 if "small" in path.stem else -40.0)
    assert case.initial.factor == (1.0 if "as_printed" in path.stem else 3.12)
    assert (case.schedule.dt, case.schedule.frames, case.schedule.steps_per_frame) == (0.07, 100, 1)
    assert [case.variant(name).method.law for name in case.variant_names] == [
        "linear",
        "corotational",
        "corotational",
        "corotational",
    ]
    assert 25 <= len(path.read_text(encoding="utf-8").splitlines()) <= 45


def test_defaults():
    case = load()
    assert case.path == Path("beam.toml") and case.variant_name is None and case.notes == ()
    assert case.mesh.split == "kuhn" and case.mesh_path is None
    assert case.loads.gravity is None and case.loads.body_force is None and case.loads.traction == ()
    assert case.initial.velocity is None and case.initial.spin is None and case.initial.factor == 1.0
    assert case.method.model_dump() == {
        "model": "fixed",
        "volume_tolerance": 0.01,
        "law": "corotational",
        "rotation": "polar",
        "rotation_at": "points",
        "volumetric": "full",
        "stepper": "backward_euler",
        "iterations": 1,
        "mass": "consistent",
        "linear_solver": "auto",
        "linear_rtol": 1e-8,
        "tolerance": 1e-9,
        "max_iterations": 100,
        "tangent": "projected",
        "inversion": "flip",
    }
    assert case.output.format == "vtu"
    assert case.movie.model_dump() == {
        "variants": ("linear", "polar"),
        "speed": 1.0,
        "fps": 30,
        "size": (1280, 720),
        "title": None,
    }


def test_integers_are_numbers_where_numbers_are_wanted():
    assert load({"schedule.dt": 1, "mesh.size": [4, 12, 4]}).schedule.dt == 1.0


def test_everything_that_can_be_said_survives_a_round_trip():
    spin = {"axis": [0.0, 0.0, 1.0], "rate": 90.0, "center": [0.0, 1.0, 2.0]}
    everything = {
        "supports": [
            {
                "box": [[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]],
                "motion": {"velocity": [1.0, 0.0, 0.0], "spin": spin},
            },
            {"sphere": {"center": [0.0, 0.0, 0.0], "radius": 1.0}},
            {"below": {"axis": "z", "at": -1.0}},
            {"above": {"axis": "x", "at": 3.0}, "motion": {"spin": spin}},
            {"nodes": [0, 7]},
            {"plane": "z", "at": 9.0, "motion": {"displacement": [1.0, 0.0, 0.0], "history": "t", "until": 2.0}},
        ],
        "loads.gravity": {"value": [0.0, 0.0, -9.81], "history": "min(t/0.5, 1)"},
        "loads.body_force": [0.0, -18.0, -9.0],
        "loads.traction": [
            {"plane": "y", "at": 0.0, "normal_traction": 1e5, "history": [[0.0, 0.0], [1.0, 2.0]]},
            {"plane": "y", "at": 0.0, "traction": [1e5, 0.0, 0.0]},
        ],
        "loads.point": [
            {"at": [0.0, 1.0, 2.0], "force": [0.0, 0.0, 1.0]},
            {"plane": "x", "at": 1.0, "force": [0.0, 0.0, 1.0]},
        ],
        "initial": {"velocity": [0.0, 0.0, -1.0], "factor": 2.0, "spin": spin},
        "method.iterations": "converged",
        "schedule": {"dt": 0.1, "frame_interval": 0.3, "frames": 4},
        "movie": {"variants": ["polar"], "speed": 0.5, "title": "größer → 2 m³"},
    }
    case = load(everything)
    assert case.loads.body_force.model_dump() == {"value": (0.0, -18.0, -9.0), "factor": 1.0, "history": None}
    assert case.schedule.steps_per_frame == 3
    Path("again.toml").write_text(case.to_toml(), encoding="utf-8")
    assert load_case("again.toml").as_dict() == case.as_dict()
    resolved = case.variant("linear")
    Path("resolved.toml").write_text(resolved.to_toml(), encoding="utf-8")
    assert load_case("resolved.toml").as_dict() == resolved.as_dict()
    assert "variants" not in resolved.as_dict() and "variants" not in resolved.as_dict()["movie"]


def test_a_case_is_frozen_and_can_be_sent_to_another_process():
    case = load()
    with pytest.raises(ValueError, match="frozen"):
        case.name = "other"
    with pytest.raises(ValueError, match="frozen"):
        case.schedule.dt = 1.0
    assert pickle.loads(pickle.dumps(case)) == case


def test_mesh_file_is_found_from_the_case_file_and_from_a_copy_elsewhere():
    for folder in ("cases", "outputs/beam/linear"):
        Path(folder).mkdir(parents=True)
    document = {**SMALL, "mesh": {"file": "meshes/a.vtu", "scale": 8.98, "order": 1, "refine": 0}}
    case = load_case(write(document, "cases/beam.toml")).variant("linear")
    assert case.mesh_path == Path("cases/meshes/a.vtu")
    assert case.as_dict()["mesh"] == {"file": "meshes/a.vtu", "scale": 8.98, "order": 1, "refine": 0}
    saved = Path("outputs/beam/linear/case.toml")
    saved.write_text(case.to_toml(saved.parent), encoding="utf-8")
    assert tomllib.loads(saved.read_text())["mesh"]["file"] == "../../../cases/meshes/a.vtu"
    assert os.path.realpath(load_case(saved).mesh_path) == os.path.realpath(case.mesh_path)


def test_an_absolute_mesh_file_stays_absolute():
    case = load({"mesh": {"file": "/data/a.vtu"}})
    assert case.mesh_path == Path("/data/a.vtu")
    assert tomllib.loads(case.to_toml("elsewhere"))["mesh"]["file"] == "/data/a.vtu"


def test_no_numerics_are_imported():
    for file in Path(pipeline.case.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            allowed = {
                "ast", "collections", "difflib", "html", "itertools", "math", "operator", "os", "pathlib", "pydantic",
                "pydantic_core", "re", "tomli_w", "tomllib", "typing",
            }  # fmt: skip
            for name in names:
                assert name.split(".")[0] in allowed or name.startswith(
                    ("pipeline.case", "pipeline.errors", "pipeline.system.times")
                )


# Variants


def test_a_variant_is_the_case_with_its_overrides():
    case = load()
    linear = case.variant("linear")
    assert linear.method.law == "linear" and linear.method.rotation == "polar"
    assert linear.variant_name == "linear" and linear.variants == {} and linear.path == case.path
    assert linear.own_keys == ("method.law",) and linear.variant_names == ("linear",)
    assert case.method.law == "corotational" and case.variant_names == ("linear", "polar")
    assert linear.variant("linear") == linear


def test_a_case_without_variants_has_one():
    for document in ({k: v for k, v in SMALL.items() if k != "variants"}, {**SMALL, "variants": {}}):
        case = load(document=document)
        assert case.variant_names == ("default",) and case.movie.variants == ("default",)
        assert case.variant("default").variant_name == "default"


def test_an_unknown_variant_names_the_choices():
    with pytest.raises(CaseError) as caught:
        load().variant("linaer")
    assert str(caught.value) == "beam.toml: no variant 'linaer'; choose from linear, polar"


def test_overrides_come_before_those_of_variants():
    case = load({"method.law": "stvk", "variants.third": {"schedule.dt": 0.01}})
    assert [case.variant(name).method.law for name in case.variant_names] == ["linear", "stvk", "stvk"]
    assert case.variant("third").schedule.dt == 0.01
    assert load({"variants.polar.method.law": "arap"}).variants["polar"] == {"method.law": "arap"}


def test_an_unquoted_dotted_key_replaces_the_table_and_a_note_says_so():
    case = load({"method": {"law": "a", "stepper": "b"}, "variants.linear": {"method": {"law": "linear"}}})
    linear = case.variant("linear")
    assert linear.method.stepper == "backward_euler"
    assert linear.notes == ("variants.linear.method replaces the whole table: stepper reset to the default",)


def test_a_variant_changes_dt_under_a_frame_interval():
    case = load({"schedule": {"dt": 0.1, "frame_interval": 0.2, "frames": 3}, "variants.polar.schedule.dt": 0.05})
    assert case.schedule.steps_per_frame == 2 and case.variant("polar").schedule.steps_per_frame == 4


def test_error_names_the_key_or_the_override_that_set_it():
    case = load()
    assert str(case.make_error("method.law", "no")) == "beam.toml: method.law: no"
    assert str(case.variant("polar").make_error("method.law", "no")) == "beam.toml: method.law: no"
    wanted = 'beam.toml: variants.linear."method.law": no'
    assert str(case.variant("linear").make_error("method.law", "no")) == wanted


# Steps


def test_steps_cut_the_schedule():
    assert load(steps=7).schedule.frames == 7
    assert load({"schedule.steps_per_frame": 3}, steps=7).variant("linear").schedule.frames == 2
    assert load(steps=1000).schedule.frames == 100


@pytest.mark.parametrize(
    "own",
    [
        {"schedule.steps_per_frame": 5, "schedule.frames": 20},
        {"schedule.frames": 20, "schedule": {"dt": 0.07, "frames": 20, "steps_per_frame": 5}},
    ],
)
def test_steps_cut_the_schedule_of_a_variant(own):
    case = load({"variants.polar": own}, steps=10)
    assert case.variant("polar").schedule.frames == 2 and case.variant("linear").schedule.frames == 10


def test_fewer_steps_than_a_frame_takes():
    wanted = "beam.toml: schedule.steps_per_frame: a frame takes 5 steps, more than the 4 requested"
    assert message({"schedule.steps_per_frame": 5}, steps=4) == wanted
    wanted = wanted.replace("schedule.steps_per_frame", 'variants.polar."schedule.steps_per_frame"')
    assert message({"variants.polar.schedule.steps_per_frame": 5}, steps=4) == wanted
    wanted = "beam.toml: schedule.frame_interval: a frame takes 2 steps, more than the 1 requested"
    assert message({"schedule": {"dt": 0.1, "frame_interval": 0.2, "frames": 3}}, steps=1) == wanted


# Messages: override -> what follows "beam.toml: "

SPIN = {"axis": [0, 0, 1], "rate": 1}
WRONG = [
    # Numbers
    ({"schedule.dt": -0.1}, "schedule.dt: -0.1 is not positive"),
    ({"schedule.dt": 0}, "schedule.dt: 0 is not positive"),
    ({"schedule.dt": "abc"}, "schedule.dt: 'abc' is not a number"),
    ({"schedule.dt": True}, "schedule.dt: true is not a number"),
    ({"schedule.dt": "0.1"}, "schedule.dt: '0.1' is not a number; write 0.1"),
    ({"schedule.dt": float("inf")}, "schedule.dt: inf is not finite"),
    ({"schedule.dt": float("nan")}, "schedule.dt: nan is not finite"),
    ({"schedule.dt": 10**400}, f"schedule.dt: 1{'0' * 56}... is too large"),
    ({"schedule.dt": 10**6000}, "schedule.dt: a number of thousands of digits is too large"),
    ({"schedule.dt": [1]}, "schedule.dt: [1] is not a number"),
    ({"schedule.dt": None}, "schedule.dt: None is not a TOML value"),
    ({"schedule.frames": 0}, "schedule.frames: 0 is not positive"),
    ({"schedule.frames": 1.5}, "schedule.frames: 1.5 is not an integer"),
    ({"schedule.frames": 2.0}, "schedule.frames: 2.0 is not an integer"),
    ({"schedule.frames": True}, "schedule.frames: true is not an integer"),
    ({"schedule.frames": 2**40}, "schedule.frames: 1099511627776 is too large"),
    # Material
    ({"material.poisson_ratio": 0.5}, "material.poisson_ratio: 0.5 is not below 0.5"),
    ({"material.poisson_ratio": -1}, "material.poisson_ratio: -1 is not above -1"),
    ({"material.youngs_modulus": 0.0}, "material.youngs_modulus: 0.0 is not positive"),
    ({"material.density": -1}, "material.density: -1 is not positive"),
    ({"material": {"youngs_modulus": 1, "density": 1}}, "material.poisson_ratio: missing"),
    ({"material": 3}, "material: 3 is not a table"),
    # Names
    ({"name": ""}, "name: is empty"),
    ({"name": 3}, "name: 3 is not a string"),
    ({"name": "a/b"}, "name: 'a/b' cannot name a folder; {folder}"),
    ({"name": ".."}, "name: '..' cannot name a folder; {folder}"),
    ({"name": "größe"}, "name: 'größe' cannot name a folder; {folder}"),
    ({"name": "a\nb"}, "name: 'a\\nb' has unprintable characters"),
    ({"variants": {"a b": {}}}, "variants.\"a b\": 'a b' cannot name a folder; {folder}"),
    # Mesh
    ({"mesh": {}}, "mesh: neither shape nor file is given"),
    ({"mesh.file": "a.vtu"}, "mesh: shape and file cannot be combined"),
    ({"mesh.scale": 2.0}, "mesh.scale: needs file, which is not given"),
    ({"mesh": {"file": "a", "cells": [1, 1]}}, "mesh.cells: needs shape, which is not given"),
    ({"mesh": {"shape": "box", "size": [1, 1]}}, "mesh.cells: missing"),
    ({"mesh.cells": [2, 8]}, "mesh.cells: has 2 entries, but size has 3"),
    ({"mesh.cells": [2]}, "mesh.cells: has 1 entry, not 2 or 3"),
    ({"mesh.cells": [2, 0, 1]}, "mesh.cells.1: 0 is not positive"),
    ({"mesh.cells": 4}, "mesh.cells: 4 is not a list"),
    ({"mesh.size": [1, "a", 1]}, "mesh.size.1: 'a' is not a number"),
    ({"mesh": {"file": "a", "scale": 0}}, "mesh.scale: 0 is not positive"),
    # Supports
    ({"supports": [{}]}, "supports.0: no selector; give one of plane, box, sphere, below, above, nodes"),
    ({"supports": {}}, "supports: {} is not a list"),
    ({"supports": [3]}, "supports.0: 3 is not a table"),
    ({"supports": [{"plane": "y"}]}, "supports.0.at: missing"),
    ({"supports": [{"at": 1}]}, "supports.0.at: needs plane, which is not given"),
    ({"supports": [{"nodes": [0], "at": 1}]}, "supports.0.at: needs plane, which is not given"),
    ({"supports": [{"plane": "w", "at": 1}]}, "supports.0.plane: 'w' is not one of x, y, z"),
    ({"supports.0.nodes": [1]}, "supports.0: plane and nodes cannot be combined"),
    ({"supports": [{"nodes": [1, -1]}]}, "supports.0.nodes.1: -1 is negative; nodes are counted from 0"),
    ({"supports": [{"nodes": []}]}, "supports.0.nodes: is empty"),
    ({"supports": [{"box": [[0, 0]]}]}, "supports.0.box: has 1 entry, not 2"),
    ({"supports": [{"box": [[0, 0], [1, 1, 1]]}]}, "supports.0.box: corners have 2 and 3 entries"),
    (
        {"supports": [{"box": [[0, 2], [1, 1]]}]},
        "supports.0.box: [0.0, 2.0] is not below [1.0, 1.0]; write [[lowest], [highest]]",
    ),
    ({"supports": [{"sphere": {"center": [0, 0, 0]}}]}, "supports.0.sphere.radius: missing"),
    ({"supports.0.motion": {}}, "supports.0.motion: none of velocity, spin and displacement is given"),
    (
        {"supports.0.motion": {"spin": {"axis": [0, 1], "rate": 1}}},
        "supports.0.motion.spin.axis: has 2 entries, not 3",
    ),
    # Loads and initial state
    ({"loads.gravity": 9.81}, "loads.gravity: 9.81 is not a list"),
    ({"loads.gravity": [0, 0, 0, 0]}, "loads.gravity: has 4 entries, not 2 or 3"),
    ({"loads.body_force": [0, "a"]}, "loads.body_force.value.1: 'a' is not a number"),
    ({"loads.body_force": 3}, "loads.body_force: 3 is not a table"),
    ({"loads.body_force": {"factor": 3}}, "loads.body_force.value: missing"),
    (
        {"loads.traction": [{"plane": "y", "at": 0}]},
        "loads.traction.0.normal_traction: missing; give normal_traction, or traction as a vector",
    ),
    ({"initial.spin": {**SPIN, "axis": [0, 0, 0]}}, "initial.spin.axis: a zero vector is not a direction"),
    ({"initial.spin.axis": [0, 0, 1]}, "initial.spin.rate: missing"),
    ({"initial.factor": "big"}, "initial.factor: 'big' is not a number"),
    # Method
    ({"method.iterations": 0}, 'method.iterations: 0 is not a positive integer or "converged"'),
    ({"method.iterations": 1.0}, 'method.iterations: 1.0 is not a positive integer or "converged"'),
    ({"method.iterations": True}, 'method.iterations: true is not a positive integer or "converged"'),
    ({"method.mass": "heavy"}, "method.mass: 'heavy' is not one of consistent, lumped"),
    ({"method.tangent": []}, "method.tangent: [] is not one of projected, exact, frozen"),
    ({"material.density": 1e31}, "material.density: 1e+31 is too large; numbers go up to 1e+30"),
    ({"loads": {"gravity": [0.0, -2e30, 0.0]}}, "loads.gravity.1: -2e+30 is too large; numbers go up to 1e+30"),
    ({"schedule.dt": 1e-31}, "schedule.dt: 1e-31 is too small; positive numbers start at 1e-30"),
    ({"method.linear_rtol": 1}, "method.linear_rtol: 1 is not between 0 and 1"),
    ({"method.law": 7}, "method.law: 7 is not a string"),
    # Schedule
    ({"schedule": {"frames": 3}}, "schedule.dt: missing"),
    ({"schedule.frame_interval": 0.1}, "schedule.frame_interval: 0.1 is not a multiple of dt = 0.07"),
    ({"schedule.frame_interval": 0.01}, "schedule.frame_interval: 0.01 is not a multiple of dt = 0.07"),
    (
        {"schedule.frame_interval": 1e30, "schedule.dt": 1e-30},
        "schedule.frame_interval: 1e+30 is not a multiple of dt = 1e-30",
    ),
    (
        {"schedule.frame_interval": 0.14, "schedule.steps_per_frame": 2},
        "schedule: frame_interval and steps_per_frame cannot be combined",
    ),
    # Output and movie
    ({"output.format": "xdmf"}, "output.format: 'xdmf' is not one of vtu, vtkhdf"),
    ({"movie.variants": ["linaer"]}, "movie.variants.0: no variant 'linaer'; choose from linear, polar"),
    ({"movie.variants": ["polar", "polar"]}, "movie.variants.1: 'polar' is listed twice"),
    ({"movie.fps": 121}, "movie.fps: 121 is not between 1 and 120"),
    ({"movie.size": [1280, 721]}, "movie.size.1: 721 is not even; video encoders need it"),
    ({"movie.size": [1280]}, "movie.size: has 1 entry, not 2"),
    ({"movie.speed": 0}, "movie.speed: 0 is not positive"),
    # Unknown keys
    ({"method.laww": "linear"}, 'method.laww: unknown key; did you mean "method.law"?'),
    ({"methodd.law": "linear"}, 'methodd.law: unknown key; did you mean "method.law"?'),
    ({"law": "linear"}, 'law: unknown key; did you mean "method.law"?'),
    ({"cells": [1, 1]}, 'cells: unknown key; did you mean "mesh.cells"?'),
    ({"velocity": [1, 1]}, 'velocity: unknown key; did you mean "initial.velocity"?'),
    ({"size": [1, 1]}, 'size: unknown key; did you mean "mesh.size" or "movie.size"?'),
    ({"supports.0.att": 3}, 'supports.0.att: unknown key; did you mean "supports.0.at"?'),
    (
        {"material.E": 3},
        "material.E: unknown key; choose from youngs_modulus, poisson_ratio, density, mass_damping, stiffness_damping",
    ),
    (
        {"material": {"youngs_moduls": 1}},
        'material.youngs_moduls: unknown key; did you mean "material.youngs_modulus"?',
    ),
    ({"path": "x"}, "path: unknown key; choose from {sections}"),
    ({"": 1}, '"": unknown key; choose from {sections}'),
    ({"notes": ["x"]}, "notes: unknown key; choose from {sections}"),
    # Dotted overrides
    ({"supports.1.at": 3}, "supports.1.at: supports is a list with entries 0 to 0; it has no '1'"),
    ({"supports.at": 3}, "supports.at: supports is a list with entries 0 to 0; it has no 'at'"),
    ({"supports.²": 3}, "supports.\"²\": supports is a list with entries 0 to 0; it has no '²'"),
    ({"name.x": 3}, "name.x: name is 'beam', not a table"),
    # Variants
    ({"variants": 3}, "variants: 3 is not a table"),
    ({"variants.linear": 3}, "variants.linear: 3 is not a table"),
    (
        {"variants.linear.method.laww": "linear"},
        'variants.linear."method.laww": unknown key; did you mean "method.law"?',
    ),
    (
        {"variants.linear.methodd.law": "linear"},
        'variants.linear."methodd.law": unknown key; did you mean "method.law"?',
    ),
    ({"variants.linear.schedule.dt": -1}, 'variants.linear."schedule.dt": -1 is not positive'),
    ({"variants.linear": {"schedule": {"dt": -1}}}, "variants.linear.schedule.dt: -1 is not positive"),
    ({"variants.linear.mesh.file": "a"}, 'variants.linear."mesh.file": shape and file cannot be combined'),
    (
        {"variants.linear.supports.3.at": 1},
        "variants.linear.\"supports.3.at\": supports is a list with entries 0 to 0; it has no '3'",
    ),
    (
        {"variants.linear.movie.fps": 5},
        'variants.linear."movie.fps": a variant cannot change movie, only mesh, material, materials, supports, loads, '
        "initial, method, schedule, output",
    ),
]
WORDS = {
    "folder": "use up to 100 letters, digits, _, - and ., not starting with .",
    "sections": ", ".join([*SMALL][:3])
    + ", materials, supports, loads, initial, method, schedule, output, movie, variants",
}


@pytest.mark.parametrize(("overrides", "wanted"), WRONG, ids=[wanted[:50] for _, wanted in WRONG])
def test_message(overrides, wanted):
    for word, text in WORDS.items():
        wanted = wanted.replace("{" + word + "}", text)
    assert message(overrides) == f"beam.toml: {wanted}"


@pytest.mark.parametrize("section", ["name", "mesh", "material", "schedule"])
def test_a_missing_section(section):
    assert message(document={k: v for k, v in SMALL.items() if k != section}) == f"beam.toml: {section}: missing"


def test_a_fault_that_only_the_whole_variant_has():
    """No single override is to blame: the variant and the place are named."""
    overrides = {
        "schedule": {"dt": 0.1, "frame_interval": 0.2, "frames": 3},
        "variants.polar.schedule.dt": 0.15,
    }
    assert message(overrides) == (
        "beam.toml: variants.polar: schedule.frame_interval: 0.2 is not a multiple of dt = 0.15"
    )


# Files


def refused(path) -> str:
    with pytest.raises(CaseError) as caught:
        load_case(path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_missing_file_names_those_that_are_called_alike():
    assert refused("bar.toml") == "bar.toml: no such file"
    assert refused("nowhere/bar.toml") == "nowhere/bar.toml: no such file"
    write(SMALL)
    assert refused("bar.toml") == "bar.toml: no such file"  # beam.toml is not like it
    assert refused("baem.toml") == "baem.toml: no such file; did you mean beam.toml?"
    Path("cases").mkdir()
    for name in ("bar", "bar_small", "swing2d"):
        write(SMALL, f"cases/{name}.toml")
    assert refused("bar.toml") == "bar.toml: no such file; did you mean cases/bar.toml?"
    assert refused("bar_smal") == "bar_smal: no such file; did you mean cases/bar_small.toml?"
    assert refused("cases/swing.toml") == "cases/swing.toml: no such file; did you mean cases/swing2d.toml?"
    assert refused("nope.toml") == "nope.toml: no such file"


def test_a_folder_is_told_with_what_it_has():
    Path("cases").mkdir()
    for index in range(9):
        write(SMALL, f"cases/{index}.toml")
    names = ", ".join(f"{index}.toml" for index in range(8))
    assert refused("cases") == f"cases: is a folder, not a case file; cases has {names}, ..."


def test_a_path_that_is_none():
    assert refused("a\0b.toml") == "'a\\x00b.toml': no such file"
    assert refused("a" * 300).startswith("a" * 300 + ": ")
    if Path("/dev/null").exists():
        assert refused("/dev/null") == "/dev/null: is not a regular file"


@pytest.mark.parametrize(
    ("content", "wanted"),
    [
        (
            b'name = "beam"\n[mesh\n',
            "not TOML: Expected ']' at the end of a table declaration (at line 2, column 6)",
        ),
        (b"name = ", "not TOML: Invalid value (at line 1, the end of the file)"),
        (b'name = "a"\nname = "b"\n', "not TOML: Cannot overwrite a value (at line 2, column 11)"),
        (b'title = "x"\nname = "\xff"\n', "line 2: not UTF-8"),
        (b"", "name: missing"),
        (b"\xef\xbb\xbfname = 3", "name: 3 is not a string"),
    ],
)
def test_a_file_that_is_no_case(content, wanted):
    Path("bad.toml").write_bytes(content)
    assert refused("bad.toml") == f"bad.toml: {wanted}"


@pytest.mark.parametrize("content", ["a = " + "9" * 5000, "a = " + "[" * 5000, "a = 2020-02-31", "a." * 9000 + "b = 1"])
def test_a_file_at_the_parsers_limits(content):
    Path("bad.toml").write_text(content)
    assert refused("bad.toml").startswith("bad.toml: ")


def test_a_byte_order_mark_is_no_fault():
    Path("bom.toml").write_bytes(b"\xef\xbb\xbf" + tomli_w.dumps(SMALL).encode())
    assert load_case("bom.toml").name == "beam"


# --set


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("schedule.dt=0.1", ("schedule.dt", 0.1)),
        (" schedule.frames = 7 ", ("schedule.frames", 7)),
        ("method.law=linear", ("method.law", "linear")),
        ('method.law="linear"', ("method.law", "linear")),
        ("loads.gravity=[0, 0, -1]", ("loads.gravity", [0, 0, -1])),
        ('mesh={file = "a=b.vtu"}', ("mesh", {"file": "a=b.vtu"})),
        ("a=true", ("a", True)),
        ("a=", ("a", "")),
        ("a=b=c", ("a", "b=c")),
        ("a=[1, 2", ("a", "[1, 2")),
        ("a=1\nb=2", ("a", "1\nb=2")),
        ("a=" + "9" * 5000, ("a", "9" * 5000)),
    ],
)
def test_parse_override(text, wanted):
    assert parse_override(text) == wanted


@pytest.mark.parametrize("text", ["schedule.dt", "", "=3"])
def test_an_override_without_key_or_value(text):
    with pytest.raises(CaseError) as caught:
        parse_override(text)
    assert str(caught.value) == f"--set {text!r}: write key=value, such as schedule.dt=0.01"


def test_an_override_reaches_into_a_list():
    assert load({"supports.0.at": 3}).supports[0].at == 3.0
    assert load({"mesh.cells.1": 5}).mesh.cells == (2, 5, 2)


def test_overrides_leave_what_they_were_given_alone():
    overrides = {
        "variants.linear.schedule.dt": 0.1,
        "mesh": {"shape": "box", "size": [1, 1], "cells": [1, 1]},
    }
    before = copy.deepcopy(overrides)
    load(overrides, steps=3)
    assert overrides == before


def test_a_bare_vector_becomes_a_table_if_one_of_its_keys_is_set():
    case = load({"loads.gravity": [0.0, 0.0, -9.81], "loads.gravity.history": "t", "loads.body_force": [1.0, 0.0, 0.0]})
    assert case.loads.gravity.value == (0.0, 0.0, -9.81) and case.loads.gravity.history == "t"
    assert case.as_dict()["loads"]["gravity"] == {"value": [0.0, 0.0, -9.81], "history": "t"}
    case = load({"loads.body_force": [1.0, 0.0, 0.0], "loads.body_force.history": [[0, 0], [1, 2]]})
    assert case.loads.body_force.history == ((0.0, 0.0), (1.0, 2.0)) and case.loads.body_force.factor == 1.0
    assert load({"loads.gravity": [0, 0, -1]}).as_dict()["loads"]["gravity"] == [0.0, 0.0, -1.0]
    assert load({"loads.gravity": [0, 0, -1], "loads.gravity.1": 5}).loads.gravity == (0.0, 5.0, -1.0)
    with pytest.raises(CaseError, match=r"loads\.gravity is a list with entries 0 to 2; it has no 'scale'"):
        load({"loads.gravity": [0, 0, -1], "loads.gravity.scale": 2})


# Junk never raises anything but CaseError

SCALARS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(10**30), 10**30),
    st.sampled_from([10**400, 2**63, 0.5, -1.0, 1e-320, 1e308, "converged", "y", "", "{message}", "sin(t)", "(((t"]),
    st.floats(),
    st.text(max_size=8),
    st.dates(),
    st.binary(max_size=3),
)
KEYWORDS = st.sampled_from(
    """
    name mesh shape size cells file scale plane at box sphere center radius below axis nodes motion
    velocity spin rate gravity body_force value factor traction dt frames frame_interval history until force point
    steps_per_frame variants movie a.b 0
    """.split()
)
KEYS = st.one_of(KEYWORDS, st.text(max_size=5))
JUNK = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(KEYS, inner, max_size=4),
    max_leaves=12,
)
PLACES = st.one_of(
    st.sampled_from(
        """
    name mesh mesh.size mesh.cells mesh.file mesh.split material material.density supports
    supports.0 supports.0.at supports.0.box supports.0.sphere supports.0.motion
    supports.0.motion.spin supports.0.motion.history supports.0.motion.displacement loads loads.body_force
    loads.body_force.history loads.traction loads.gravity loads.point initial initial.spin
    method method.law method.iterations method.mass schedule schedule.dt schedule.frames
    schedule.frame_interval output output.format movie movie.variants movie.size movie.fps
    movie.title variants variants.linear variants.linear.schedule.dt variants.linear.loads
    """.split()
    ),
    st.lists(KEYS, max_size=4).map(".".join),
)
MANY = settings(max_examples=500, deadline=None, suppress_health_check=list(HealthCheck))


@MANY
@given(place=PLACES, value=JUNK, steps=st.none() | st.integers(-3, 200))
@example(place="a." * 20000, value=1, steps=None)
@example(place="variants", value={"a": {"": 1}}, steps=None)
def test_junk_is_a_case_error_or_a_case(place, value, steps):
    try:
        case = load({place: value}, steps=steps)
    except CaseError as error:
        assert len(str(error).splitlines()) == 1 and "pydantic" not in str(error)
        str(error).encode("utf-8")
    else:
        for name in case.variant_names:
            Path("again.toml").write_text(case.variant(name).to_toml(), encoding="utf-8")
            assert load_case("again.toml").as_dict() == case.variant(name).as_dict()


@MANY
@given(content=st.binary(max_size=60) | st.text(max_size=60).map(lambda text: text.encode("utf-8", "replace")))
def test_junk_files_are_case_errors(content):
    Path("junk.toml").write_bytes(content)
    refused("junk.toml")


@MANY
@given(st.text())
def test_junk_for_set_is_a_case_error_or_a_pair(text):
    try:
        key, _ = parse_override(text)
    except CaseError as error:
        str(error).encode("utf-8")
    else:
        assert key


@MANY
@given(st.data())
def test_mutilated_case_files_are_case_errors_or_cases(data):
    text = data.draw(st.sampled_from(CASES)).read_text(encoding="utf-8")
    start = data.draw(st.integers(0, len(text)))
    length = data.draw(st.integers(0, 30))
    Path("cut.toml").write_text(
        text[:start] + data.draw(st.text(max_size=3)) + text[start + length :],
        encoding="utf-8",
        errors="replace",
    )
    try:
        load_case("cut.toml")
    except CaseError as error:
        assert "\n" not in str(error)


def test_relative_paths_hold_through_a_linked_folder():
    Path("real/deep").mkdir(parents=True)
    Path("cases").mkdir()
    Path("outputs").symlink_to("real/deep")
    case = load_case(write({**SMALL, "mesh": {"file": "a.vtu"}}, "cases/beam.toml"))
    Path("cases/a.vtu").write_text("mesh")
    Path("outputs/case.toml").write_text(case.to_toml("outputs"), encoding="utf-8")
    assert load_case("outputs/case.toml").mesh_path.read_text() == "mesh"
    shutil.rmtree("real")
