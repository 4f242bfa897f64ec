"""The command line: every error is one line with its exit code; --quiet prints nothing."""

import inspect
import json
import re
import subprocess
import sys
from pathlib import Path

import meshio
import numpy as np
import pytest

from pipeline.case import load_case
from pipeline.cli import main
from pipeline.cli.study import STUDIES
from pipeline.cli.terminal import Bars
from pipeline.errors import SolveError, shorten
from pipeline.results.case_run import run_case
from pipeline.stepping.backward_euler import BackwardEuler
from tests.bodies import skip_figures, write_case

ROOT = Path(__file__).resolve().parents[2]
TET = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
MESHES = {
    "surface.vtu": [("triangle", np.array([[0, 1, 2], [0, 1, 3]]))],
    "inverted.vtu": [("tetra", np.array([[1, 0, 2, 3]]))],
    "hexahedra.vtu": [("hexahedron", np.array([[0, 1, 2, 3, 0, 1, 2, 3]]))],
}


@pytest.fixture(autouse=True)
def _in_a_folder_without_figures(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    skip_figures(monkeypatch)


@pytest.fixture
def case(tmp_path) -> str:
    write_case(tmp_path)
    return "beam.toml"


def run(*arguments: str) -> int:
    return main(["run", *arguments, "--no-movie"])


# Errors of the case file: sections, and the text after "CaseError: beam.toml: "

MATERIAL = {"youngs_modulus": 1e7, "poisson_ratio": 0.3, "density": 1000.0}
SCHEDULE = {"dt": 0.02, "frames": 4}
WRONG = {
    "unknown_key": ({"schedule": SCHEDULE | {"framse": 3}}, 'schedule.framse: unknown key; did you mean "schedule.fra'),
    "unknown_table": ({"load": {}}, 'load: unknown key; did you mean "loads"?'),
    "wrong_type": ({"material": MATERIAL | {"density": "heavy"}}, "material.density: 'heavy' is not a number"),
    "poisson_ratio": ({"material": MATERIAL | {"poisson_ratio": 0.5}}, "material.poisson_ratio: 0.5 is not below 0.5"),
    "no_step": ({"schedule": SCHEDULE | {"dt": 0.0}}, "schedule.dt: 0.0 is not positive"),
    "negative_step": ({"schedule": SCHEDULE | {"dt": -0.1}}, "schedule.dt: -0.1 is not positive"),
    "no_free_node": ({"supports": [{"below": {"axis": "y", "at": 9.0}}]}, "supports: all 16 nodes are held"),
    "no_held_node": ({"supports": [{"plane": "y", "at": 9.0}]}, "supports.0: selects no node"),
    "missing_mesh": ({"mesh": {"file": "none.vtu"}}, "mesh: none.vtu: no such mesh file"),
    "surface": ({"mesh": {"file": "surface.vtu"}}, "mesh: surface.vtu: triangles that do not lie in a plane"),
    "inverted": ({"mesh": {"file": "inverted.vtu"}}, "mesh: inverted.vtu: 1 inverted or flat tetrahedron cells"),
    "hexahedra": ({"mesh": {"file": "hexahedra.vtu"}}, "mesh: hexahedra.vtu: has hexahedron"),
    "junk_mesh": ({"mesh": {"file": "junk.vtu"}}, "mesh: junk.vtu: "),
    "law": ({"method": {"law": "lienar"}, "variants": None}, "method.law: 'lienar' is not one of linear, corotational"),
    "gravity": ({"loads": {"gravity": [0.0, 1.0]}}, "loads.gravity: [0.0, 1.0] has 2 components"),
    "variant": (
        {"variants": {"odd": {"schedule.dt": -1.0}}},
        'variants.odd."schedule.dt": -1.0 is not positive',
    ),
}


@pytest.mark.parametrize("verb", ["check", "run"])
@pytest.mark.parametrize("name", WRONG)
def test_an_error_of_the_case_is_one_line_with_file_and_key(tmp_path, capfd, verb, name):
    sections, wanted = WRONG[name]
    write_case(tmp_path, **sections)
    (tmp_path / "junk.vtu").write_text("junk")
    for file, blocks in MESHES.items():
        meshio.Mesh(TET, blocks).write(tmp_path / file)
    capfd.readouterr()
    assert main([verb, "beam.toml"]) == 2
    out, err = capfd.readouterr()
    assert out == ""
    assert err.count("\n") == 1 and err.startswith(f"CaseError: beam.toml: {wanted}")
    assert not (tmp_path / "outputs").exists()


BOX = {"shape": "box", "size": [1.0, 3.0, 1.0], "cells": [1, 3, 1]}
LONG = "9" * 5000
TOO_LONG = {
    "split": {"mesh": BOX | {"split": LONG}},
    "shape": {"mesh": BOX | {"shape": LONG}},
    "mesh_file": {"mesh": {"file": LONG}},
    "law": {"method": {"law": LONG}},
    "key": {LONG: 1},
    "many_variants": {"variants": {f"v{i}": {} for i in range(1000)}, "movie": {"variants": ["none"]}},
}


@pytest.mark.parametrize("name", TOO_LONG)
def test_long_quoted_values_are_shortened(tmp_path, capfd, name):
    write_case(tmp_path, **TOO_LONG[name])
    assert run("beam.toml") == 2
    error = capfd.readouterr().err
    assert error.startswith("CaseError: beam.toml: ") and error.count("\n") == 1 and len(error) < 2000


@pytest.mark.parametrize(
    "text",
    ["\u200b" * 57, "\u200b" * 10, "a" * 59 + "\x1b", "a" * 60 + "\x1b", "\U000e0001" * 10**6],
    ids=["many", "few", "last", "beyond", "million"],
)
def test_long_escaped_values_are_shortened(text):
    quoted = shorten(text)
    assert quoted.isprintable() and len(quoted) == 60
    assert len(shorten(text, 200)) <= 200


@pytest.mark.parametrize(
    "arguments",
    [
        ["study", "stability", "beam.toml", "--slice", LONG],
        ["study", "scaling", "beam.toml", "--method", LONG],
        ["study", "scaling", "beam.toml", "--cells", LONG],
        ["analyze", "their.pvd"],
        ["analyze", "other.pvd"],
    ],
    ids=["slice", "method", "cells", "frame", "time"],
)
def test_other_verbs_shorten_quoted_values(case, tmp_path, capfd, arguments):
    index = '<VTKFile><Collection><DataSet timestep="{}" file="{}.vtu"/></Collection></VTKFile>'
    (tmp_path / "their.pvd").write_text(index.format("0", LONG))
    (tmp_path / "other.pvd").write_text(index.format("a" + LONG, "its"))
    assert main(arguments) == 2
    error = capfd.readouterr().err
    assert "Error: " in error and error.count("\n") == 1 and len(error) < 2000


@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        (["none.toml"], "none.toml: no such file\n"),
        (["beam.toml", "--variant", "polr"], "beam.toml: no variant 'polr'; choose from linear, gram_schmidt, polar"),
        (["beam.toml", "--set", "schedule.dt"], "--set 'schedule.dt': write key=value"),
        (["beam.toml", "--set", "schedule.dt=-1"], "beam.toml: schedule.dt: -1 is not positive"),
        (["beam.toml", "--set", "schedule.dt=.002"], "beam.toml: schedule.dt: '.002' is not a number; write 0.002\n"),
        (["beam.toml", "--set", "schedule.dt=2."], "beam.toml: schedule.dt: '2.' is not a number; write 2.0\n"),
        (["beam.toml", "--set", "schedule.dt=half"], "beam.toml: schedule.dt: 'half' is not a number\n"),
        (["beam.toml", "--set", "schedule.dt='nan'"], "beam.toml: schedule.dt: 'nan' is not a number\n"),
        (
            ["beam.toml", "--set", "initial.velocity=[0, -.5, 1.e3]"],
            "beam.toml: initial.velocity: '[0, -.5, 1.e3]' is not a list; write [0, -0.5, 1.0e3]\n",
        ),
        (["beam.toml", "--set", "initial.velocity=down"], "beam.toml: initial.velocity: 'down' is not a list\n"),
        (["beam.toml", "--set", "schedul.dt=1"], 'beam.toml: schedul.dt: unknown key; did you mean "schedule.dt"?'),
        (["beam.toml", "--steps", "0"], "beam.toml: schedule.steps_per_frame: a frame takes 1 step"),
        (["."], ".: is a folder, not a case file; . has beam.toml"),
    ],
)
def test_an_error_of_the_command_is_one_line(case, capfd, arguments, wanted):
    assert run(*arguments) == 2
    out, err = capfd.readouterr()
    assert (out, err.count("\n")) == ("", 1) and err.startswith(f"CaseError: {wanted}")


def test_junk_in_a_case_file_names_the_line(tmp_path, capfd):
    (tmp_path / "bad.toml").write_text('name = "x"\nmesh = {\n')
    assert main(["check", "bad.toml"]) == 2
    out, err = capfd.readouterr()
    assert (out, err.count("\n")) == ("", 1) and err.startswith("CaseError: bad.toml: ") and "line" in err


@pytest.mark.parametrize("arguments", [[], ["fly"], ["run"], ["run", "a.toml", "--fast"], ["run", "a", "--steps", "x"]])
def test_wrong_usage_exits_with_two_and_shows_the_usage(capfd, arguments):
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2 and "usage: pipeline" in capfd.readouterr().err


VERBS = "run check movie reproduce methods analyze compare report view schema formats".split()


@pytest.mark.parametrize("verb", [[name] for name in VERBS] + [["study", name] for name in STUDIES], ids=" ".join)
def test_every_option_has_a_help_text(capfd, verb):
    with pytest.raises(SystemExit) as caught:
        main([*verb, "--help"])
    options = re.split(r"\n  (?=-)", capfd.readouterr().out.partition("options:")[2])
    assert caught.value.code == 0 and "--debug" in "".join(options)
    assert [text for text in options[1:] if not re.search(r"(  |\n +)\S", text)] == []


def test_defaults_in_the_help_are_those_of_the_library(capfd):
    from pipeline.studies.tradeoff.settings import make_plan
    from pipeline.studies.tradeoff.study import study_tradeoff

    with pytest.raises(SystemExit):
        main(["study", "tradeoff", "--help"])
    text = capfd.readouterr().out
    for function, name in ((make_plan, "tolerance"), (study_tradeoff, "repeats")):
        assert f"({inspect.signature(function).parameters[name].default})" in text


def test_debug_shows_where_an_error_comes_from(case):
    with pytest.raises(Exception, match="no variant"):
        run(case, "--variant", "polr", "--debug")


# Runs


def test_a_run_prints_its_results_and_their_folder(case, capfd):
    assert run(case) == 0
    lines = capfd.readouterr().out.splitlines()
    for line, name in zip(lines, ("linear", "gram_schmidt", "polar"), strict=False):
        assert (
            line.startswith(name)
            and re.search(r" finished; worst volume ratio [01]\.\d{4} ", line)
            and "x real time" in line
        )
    assert "results in outputs/beam" in lines
    assert run(case) == 0
    assert capfd.readouterr().out.count("up to date (--force solves again)") == 3
    assert run(case, "--force", "--variant", "polar") == 0
    assert capfd.readouterr().out.startswith("polar          finished")


@pytest.mark.parametrize(("name", "index"), [("vtu", "series.pvd"), ("vtkhdf", "series.vtkhdf")])
def test_the_summary_names_the_file_that_lists_the_frames(case, capfd, name, index):
    assert run(case, "--variant", "polar", "--set", f"output.format={name}") == 0
    assert capfd.readouterr().out.splitlines()[-1] == f"  polar/{index}"
    assert Path("outputs/beam/polar", index).is_file()


def test_quiet_prints_nothing(case, capfd):
    assert run(case, "--quiet") == 0
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("also", [[], ["--quiet"], ["-v"]])
def test_json_prints_only_json(case, capfd, also):
    assert run(case, "--json", *also) == 0
    out, err = capfd.readouterr()
    summary = json.loads(out)
    assert err == "" or also == ["-v"]
    assert summary["folder"] == "outputs/beam" and summary["variants"].keys() == {"linear", "gram_schmidt", "polar"}
    for name, record in summary["variants"].items():
        assert record["status"] == "finished" and record["frames"] == 5
        assert record == json.loads(Path("outputs/beam", name, "run.json").read_text())
    assert run(case, "--json") == 0
    assert {record["status"] for record in json.loads(capfd.readouterr().out)["variants"].values()} == {"up to date"}


def test_steps_set_variant_and_out(case, capfd):
    arguments = ["--steps", "2", "--set", "schedule.dt=0.01", "--set", "initial.velocity=[0, 0, -5]"]
    assert run(case, *arguments, "--set", "method.mass=lumped", "--variant", "linear", "--out", "here") == 0
    assert sorted(path.name for path in Path("here/beam").iterdir() if path.is_dir()) == ["linear"]
    record = json.loads(Path("here/beam/linear/run.json").read_text())
    assert record["last_frame"] == {"index": 2, "step": 2, "time": 0.02}
    assert record["case"]["method"]["mass"] == "lumped" and record["case"]["initial"]["velocity"] == [0.0, 0.0, -5.0]
    assert not Path("outputs").exists()


def test_another_case_is_refused_with_the_difference_and_forced(case, capfd):
    assert run(case, "--quiet") == 0
    changed = [case, "--set", "schedule.dt=0.01", "--quiet"]
    assert run(*changed) == 2
    err = capfd.readouterr().err
    assert err.count("\n") == 1 and "schedule.dt: 0.02 there, 0.01 here" in err and "--force" in err
    assert run(*changed, "--force") == 0


def test_the_bar_shows_the_set_up_and_the_model_that_a_step_needed(case):
    texts = []

    class Display:
        start = staticmethod(lambda: None)
        add_task = staticmethod(lambda name, *, total, text: 0)
        update = staticmethod(lambda task, *, completed, total, text: texts.append(text))

    bars = Bars(Display())
    auto = load_case(case, overrides={"method.model": "auto"})
    run_case(auto, Path("bars"), variants=["polar"], movie=False, on_frame=bars.show_frame, on_start=bars.show_start)
    assert texts[0].startswith("setting up")
    assert len(texts) == 2 + auto.schedule.frames and texts[-1].split()[-1] in ("linear", "corotational")


def test_a_failed_variant_is_one_line_and_exit_code_three(case, capfd, monkeypatch):
    genuine = BackwardEuler.step

    def fail(self, state):
        if state.step == 2 and not self.body.law.constant_tangent:
            raise SolveError("it broke")
        return genuine(self, state)

    monkeypatch.setattr(BackwardEuler, "step", fail)
    assert run(case, "--quiet") == 3
    out, err = capfd.readouterr()
    assert out == ""
    for name, line in zip(("gram_schmidt", "polar"), err.splitlines(), strict=True):
        assert line.startswith(f"SolveError: {name}: it broke (at step 3, t = 0.06 s); after step 2 0 of 18 cells")
        assert line.endswith(f"the frames before it are in outputs/beam/{name}")


def test_an_interruption_is_one_line_and_exit_code_130(case, capfd, monkeypatch):
    def interrupt(self, state):
        raise KeyboardInterrupt

    monkeypatch.setattr(BackwardEuler, "step", interrupt)
    assert run(case, "--quiet") == 130
    out, err = capfd.readouterr()
    assert (out, err) == ("", "interrupted; frames written so far are complete\n")


def test_results_that_cannot_be_written_are_one_line_and_exit_code_four(case, capfd, tmp_path):
    (tmp_path / "file").write_text("in the way")
    assert run(case, "--out", "file", "--quiet") == 4
    out, err = capfd.readouterr()
    assert (out, err.count("\n")) == ("", 1) and err.startswith("OutputError: file/beam/")


# The other verbs


def test_check_prints_sizes_frequency_and_damping(capfd):
    assert main(["check", str(ROOT / "cases" / "bar.toml"), "--variant", "linear"]) == 0
    text = capfd.readouterr().out
    # of the thesis bar: 10.42 rad/s at dt = .07 s is z = .73 and 32 % of damping
    for words in ("linear", "81, of which 9 are held", "tetrahedra   192 in 1 component", "192 m3", "192000 kg",
                  "10.42 rad/s", "0.7297 with dt = 0.07 s", "32.1 % of critical", "0.0019 s",
                  "pressure waves travel at 384.9 m/s"):  # fmt: skip
        assert words in text, words


def test_check_prints_equal_variants_once(case, tmp_path, capfd):
    own = {"method.stepper": "bdf2"}
    write_case(tmp_path, variants={"linear": {"method.law": "linear"}, "bdf2": own, "polar": {}})
    assert main(["check", case]) == 0
    names = [line for line in capfd.readouterr().out.splitlines() if not line.startswith(" ")]
    assert names == ["linear, polar", "bdf2"]


def test_check_has_the_damping_and_phase_lag_of_the_stepper(capfd):
    def check(stepper, dt):
        arguments = ["check", str(ROOT / "cases" / "bar.toml"), "--variant", "linear", "--json"]
        assert main([*arguments, "--set", f"method.stepper={stepper}", "--set", f"schedule.dt={dt}"]) == 0
        return json.loads(capfd.readouterr().out)["linear"]

    for stepper, zeta in (("backward_euler", lambda z: z / 2), ("bdf2", lambda z: z**3 / 4)):
        numbers = check(stepper, 0.002)
        z = numbers["z"]
        assert numbers["damping"] == pytest.approx(zeta(z), rel=5 * z**2)  # the next term of the series
        assert numbers["phase_lag"] == pytest.approx(360 * z**2 / 3, rel=2 * z**2)
    explicit = check("symplectic_euler", 0.002)
    assert explicit["damping"] is None and explicit["phase_lag"] is None


@pytest.mark.parametrize(
    ("dt", "words"),
    [
        (0.07, ["bdf2 damps that mode by 4.69 % of critical; for 1 % take dt near 0.0", "lags by 41.5 degrees a per"]),
        (0.001, ["bdf2 damps that mode by 2.83e-05 % of critical\n", "lags by 0.013 degrees a period\n"]),
    ],
)
def test_check_has_a_remedy_if_one_is_needed(capfd, dt, words):
    bar = str(ROOT / "cases" / "bar.toml")
    assert (
        main(["check", bar, "--variant", "linear", "--set", "method.stepper=bdf2", "--set", f"schedule.dt={dt}"]) == 0
    )
    text = capfd.readouterr().out
    assert all(word in text for word in words), text


def test_check_as_json_has_numbers(case, capfd):
    assert main(["check", case, "--json"]) == 0
    checks = json.loads(capfd.readouterr().out)
    assert checks.keys() == {"linear", "gram_schmidt", "polar"}
    assert checks["polar"]["cells"] == 18 and checks["polar"]["held"] == 4 and checks["polar"]["mass"] == 3000.0
    assert checks["polar"]["z"] == pytest.approx(0.02 * checks["polar"]["omega_1"])


@pytest.mark.parametrize("cells", [[1, 1, 1], [1, 1]])
def test_check_of_the_smallest_bodies(tmp_path, capfd, cells):
    mesh = {"shape": "box" if len(cells) == 3 else "rectangle", "size": [1.0] * len(cells), "cells": cells}
    write_case(tmp_path, mesh=mesh, loads=None, initial=None, supports=[{"nodes": [0]}])
    assert main(["check", "beam.toml"]) == 0
    assert "omega_1" in capfd.readouterr().out


def test_methods_lists_every_name_of_the_tables(capfd):
    from pipeline.problem.methods import LAWS, LINEAR_SOLVERS, MASSES, ROTATIONS, SHAPES, STEPPERS

    assert main(["methods"]) == 0
    words = set(capfd.readouterr().out.split())
    assert {*LAWS, *ROTATIONS, *STEPPERS, *LINEAR_SOLVERS, *MASSES, *SHAPES} <= words


@pytest.mark.parametrize("folder", [".", "none"])
def test_a_movie_of_another_folder_is_an_error_of_one_line(tmp_path, capfd, folder):
    assert main(["movie", folder, "--quiet"]) == 2
    out, err = capfd.readouterr()
    assert (out, err.count("\n")) == ("", 1)


def test_version_is_that_of_the_package(capfd):
    from pipeline import __version__

    with pytest.raises(SystemExit) as caught:
        main(["--version"])
    assert caught.value.code == 0 and capfd.readouterr().out == f"pipeline {__version__}\n"


def test_the_command_as_a_process(case, tmp_path):
    """With figures, and only JSON on standard output."""
    command = [
        sys.executable,
        "-m",
        "pipeline.cli",
        "run",
        str(tmp_path / case),
        "--steps",
        "2",
        "--no-movie",
        "--json",
    ]
    done = subprocess.run([*command, "--out", str(tmp_path / "o")], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0 and done.stderr == ""
    assert {Path(path).name for path in json.loads(done.stdout)["files"]} == {
        "comparison.nc",
        "open_in_paraview.py",
        "volume.png",
        "energy.png",
    }
    for name in ("volume.png", "energy.png"):
        assert (tmp_path / "o" / "beam" / name).read_bytes().startswith(b"\x89PNG")
    refused = subprocess.run([*command, "--set", "schedule.dt=0"], capture_output=True, text=True, cwd=ROOT)
    assert (refused.returncode, refused.stdout, refused.stderr.count("\n")) == (2, "", 1)
    assert refused.stderr.endswith("schedule.dt: 0 is not positive\n")


def test_analyze_and_compare_on_the_command_line(tmp_path, capsys):
    out = tmp_path / "outputs"
    assert main(["run", str(write_case(tmp_path)), "--out", str(out), "--no-movie", "--quiet"]) == 0
    first, second = (str(out / "beam" / name) for name in ("linear", "polar"))
    assert main(["analyze", first, "--out", str(tmp_path / "one")]) == 0
    assert "worst volume ratio" in capsys.readouterr().out
    assert (tmp_path / "one" / "statistics.nc").is_file()
    assert main(["compare", first, second, "--difference", "--out", str(tmp_path / "two"), "--quiet"]) == 0
    assert capsys.readouterr().out == ""
    assert main(["compare", first, second, "--difference", "--out", str(tmp_path / "two")]) == 0
    line = capsys.readouterr().out.splitlines()[-1]
    assert re.fullmatch(r"polar: nodes up to \S+ m \(node \d+, t = \S+ s\) from linear; RMS up to \S+ m", line)
    assert main(["analyze", str(tmp_path / "nothing.pvd")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
