"""Foreign files are checked, then read in a child: it may die, hang or take all memory; the caller gets one line."""

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import meshio
import numpy as np
import pytest
import pyvista

from pipeline.cli import main
from pipeline.errors import MeshError, SeriesError
from pipeline.formats import sandbox as reader
from pipeline.formats.preflight import find_outside_name, find_refusal
from pipeline.formats.sandbox import GIGABYTES, Reader
from pipeline.mesh.files import read_mesh
from pipeline.series import read_series
from pipeline.system.child import ChildProcess
from tests.bodies import write_case
from tests.series.test_series import CELLS, make_grid, write_pvd, write_series

BAD = """
import os, signal, time
import numpy as np
from pipeline.errors import MeshError

def size(file): return os.path.getsize(file)
def arrays(file): return {"a": np.arange(6.0).reshape(2, 3), "b": [np.array(["x", "yz"]), None, "words", 3]}
def die(file, number): os.kill(os.getpid(), number)
def leave(file): os._exit(7)
def hang(file): time.sleep(60)
def spin(file):
    while True: pass
def hog(file): return np.ones(10**9)
def stumble(file): raise KeyError("no\\nsuch key")
def refuse(file): raise MeshError("no mesh")
def loud(file):
    os.write(1, b"junk" * 9)
    print("more")
    return "quiet"
def clever(file): return Clever()
class Clever:
    def __reduce__(self): return os.system, ("touch " + os.environ["TRACE"],)
def processes(file): return os.getpid()
"""


@pytest.fixture
def child(tmp_path, monkeypatch):
    """A function that asks a new Reader, whose child can import the module `bad`, about a file."""
    (tmp_path / "bad.py").write_text(BAD)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("TRACE", str(tmp_path / "trace"))
    own = Reader()
    file = tmp_path / "it.vtu"
    file.write_bytes(b"12345")

    def ask(name, *arguments):
        return own.read(f"bad:{name}", file, *arguments, error=SeriesError)

    yield ask
    own.close()


def read_error(ask, name, *arguments):
    with pytest.raises(SeriesError) as caught:
        ask(name, *arguments)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_answers_arrive_unchanged(child):
    assert child("size") == 5
    got = child("arrays")
    assert got["a"].tolist() == [[0, 1, 2], [3, 4, 5]] and got["a"].flags.writeable
    assert got["b"][0].tolist() == ["x", "yz"] and got["b"][1:] == [None, "words", 3]
    assert child("loud") == "quiet"


def test_entries_of_sys_path_that_are_no_text_are_ignored(child, monkeypatch):
    monkeypatch.setattr(sys, "path", [*sys.path, Path("/nowhere")])
    test_answers_arrive_unchanged(child)


@pytest.mark.parametrize("name", ["SIGSEGV", "SIGABRT", "SIGBUS", "SIGKILL"])
def test_a_death_is_reported_by_its_signal_and_the_next_file_is_read(child, name):
    import signal

    first = child("processes")
    text = read_error(child, "die", int(getattr(signal, name)))
    assert "it.vtu: the reader " in text
    assert "was killed" in text if name == "SIGKILL" else f"died ({name})" in text
    assert child("size") == 5 and child("processes") != first
    assert "exit code 7" in read_error(child, "leave")
    assert child("size") == 5


def test_time_is_limited(child, monkeypatch):
    child("size")
    monkeypatch.setattr(reader, "_LEAST_SECONDS", 0.5)
    began = time.monotonic()
    assert "took longer than 1 s" in read_error(child, "hang")
    assert "took longer" in read_error(child, "spin")
    assert time.monotonic() - began < 50
    monkeypatch.undo()


def test_memory_is_limited_and_the_limit_can_be_raised(child, monkeypatch):
    monkeypatch.setenv(GIGABYTES, "0.5")
    before = child("processes")
    assert f"takes more than 0.5 GB of memory; raise {GIGABYTES} to allow more" in read_error(child, "hog")
    assert child("processes") == before  # an array that is too large is no death
    monkeypatch.setenv(GIGABYTES, "junk")
    assert reader._memory_limit(0) == 2 * 10**9 and reader._memory_limit(10**9) == 40 * 10**9


def test_errors_of_parsers_and_our_own(child):
    assert "cannot be read (KeyError: 'no\\nsuch key')" in read_error(child, "stumble")
    with pytest.raises(MeshError, match=r"^no mesh$"):
        child("refuse")


def test_an_answer_that_would_run_code_is_read_error(child, tmp_path):
    assert "makes no sense" in read_error(child, "clever")
    assert not (tmp_path / "trace").exists()
    assert child("size") == 5


def test_an_interruption_ends_the_child(child, monkeypatch):
    first = child("processes")

    def interrupted(self, **_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(ChildProcess, "receive", interrupted)
        with pytest.raises(KeyboardInterrupt):
            child("size")
    assert child("processes") != first


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork here")
def test_a_forked_process_starts_its_own_child(tmp_path):
    code = (
        "import os, sys\nfrom pathlib import Path\nfrom pipeline.errors import SeriesError\n"
        "from pipeline.formats.sandbox import SHARED_READER\n"
        "ask = lambda: SHARED_READER.read('os.path:basename', Path('x'), error=SeriesError)\n"
        "assert ask() == 'x'\nfirst = SHARED_READER._child.process.pid\nchild = os.fork()\n"
        "assert ask() == 'x'\nassert (SHARED_READER._child.process.pid == first) == (child != 0)\n"
        "sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) if child else 0)"
    )
    run = subprocess.run([sys.executable, "-W", "ignore", "-c", code], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr


def test_relative_paths_work_after_chdir_and_stay_relative_in_messages(tmp_path, monkeypatch):
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        monkeypatch.chdir(tmp_path / name)
        make_grid(0).save(f"{name}.vtu")
        assert len(read_series(f"{name}.vtu")) == 1
        meshio.write(f"{name}.vtk", meshio.Mesh(make_grid(0).points, [("tetra", CELLS)]))
        assert len(read_mesh(Path(f"{name}.vtk")).cells) == len(CELLS)
    Path("b.vtk").write_text("junk")
    with pytest.raises(MeshError, match=r"^b\.vtk: cannot be read \((?!.*two/b\.vtk)"):
        read_mesh(Path("b.vtk"))


# Checks before reading


def declared(folder, *, points="27", cells="1000000000", compressor='compressor="vtkZLibDataCompressor"'):
    make_grid(0).save(folder / "f0.vtu")
    text = (folder / "f0.vtu").read_text()
    text = re.sub(r'compressor="\w+"', compressor, text)
    text = re.sub(r'NumberOfPoints="\d+"', f'NumberOfPoints="{points}"', text)
    text = re.sub(r'NumberOfCells="\d+"', f'NumberOfCells="{cells}"', text)
    (folder / "f0.vtu").write_text(text)
    return folder / "f0.vtu"


@pytest.mark.parametrize("points", ["27", "1000000000", "9" * 30])
@pytest.mark.parametrize("compressor", ['compressor="vtkZLibDataCompressor"', 'compressor="vtkLZMADataCompressor"', ""])
def test_a_billion_cells_in_a_small_file_are_refused(tmp_path, points, compressor):
    file = declared(tmp_path, points=points, compressor=compressor)
    with pytest.raises(SeriesError, match=r"declares \d+ points and 1000000000 cells, more than its \d+ bytes"):
        read_series(tmp_path)
    with pytest.raises(MeshError, match="declares"):
        read_mesh(file)


def test_a_billion_points_in_a_legacy_file_are_refused(tmp_path):
    make_grid(0).save(tmp_path / "f0.vtk", binary=False)
    text = (tmp_path / "f0.vtk").read_text()
    (tmp_path / "f0.vtk").write_text(re.sub(r"POINTS \d+", "POINTS 1000000000", text))
    with pytest.raises(SeriesError, match="declares 1000000000 points"):
        read_series(tmp_path / "f0.vtk")


BOMB = '<?xml version="1.0"?><!DOCTYPE a [<!ENTITY a "aaaaaaaaaa">{}]>'.format(
    "".join(f'<!ENTITY {b} "{f"&{a};" * 10}">' for a, b in zip("abcdefghij", "bcdefghijk", strict=True))
)


@pytest.mark.parametrize("name", ["it.vtu", "it.pvd", "it.xdmf", "it.pvtu", "it.vtp"])
def test_entities_are_refused(tmp_path, name):
    (tmp_path / name).write_text(BOMB + '<VTKFile type="Collection"><Collection>&k;</Collection></VTKFile>')
    with pytest.raises(SeriesError, match="declares entities"):
        read_series(tmp_path / name)
    if name in ("it.vtu", "it.xdmf"):
        with pytest.raises(MeshError, match="declares entities"):
            read_mesh(tmp_path / name)


@pytest.mark.parametrize("name", ["it.vtu", "it.pvd", "it.xdmf", "it.pvtu", "it.vtp"])
@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be", "utf-32", "utf-32-be"])
def test_entities_in_wide_characters_are_refused(tmp_path, name, encoding):
    # U+613C is the bytes "<a" in UTF-16: not where the first element begins
    text = BOMB.replace("?>", "?><!--\u613c-->", 1) + "<VTKFile><Collection>&k;</Collection></VTKFile>"
    (tmp_path / name).write_bytes(text.encode(encoding))
    assert "UTF-16" in (find_refusal(tmp_path / name) or "")


@pytest.mark.parametrize("before", ["<!-- <a> -->", "<?b <a> ?>"])
def test_entities_after_comments_and_instructions_are_refused(tmp_path, before):
    text = BOMB.replace("?>", "?>" + before, 1) + "<VTKFile>&k;</VTKFile>"
    (tmp_path / "it.pvd").write_text(text)
    with pytest.raises(SeriesError, match="declares entities"):
        read_series(tmp_path / "it.pvd")
    (tmp_path / "it.pvd").write_text(before + '<!-- <!ENTITY --><VTKFile type="Collection"></VTKFile>')
    assert find_refusal(tmp_path / "it.pvd") is None


@pytest.mark.parametrize(
    ("name", "bad"),
    [
        ("f0.vtu", False), ("frames/f0.vtu", False), ("a/../f0.vtu", False), ("./f0.vtu", False),
        ("../f0.vtu", True), ("a/../../f0.vtu", True), ("/etc/passwd", True), ("..\\f0.vtu", True),
        ("C:\\f0.vtu", True), ("\\\\server\\f0.vtu", True), ("..", True),
    ],
)  # fmt: skip
def test_names_outside_the_folder_are_recognized(name, bad):
    assert bool(find_outside_name(name)) == bad


def test_an_index_outside_its_folder_is_refused(tmp_path):
    (tmp_path / "in").mkdir()
    write_series(tmp_path)
    (tmp_path / "in" / "more").mkdir()
    for name in ("../f0.txt", "../../f0.vtu", "/f0.vtu", "../../../../../../../../../../f0.vtu"):
        path = write_pvd(tmp_path / "in" / "more", [(0.0, name)])
        with pytest.raises(SeriesError, match=rf"names a file outside its own folder \({name}\)"):
            read_series(path)
    (tmp_path / "in" / "a.vtu.series").write_text('{"files": [{"name": "../../f0.vtu", "time": 0}]}')
    with pytest.raises(SeriesError, match="outside its own folder"):
        read_series(tmp_path / "in" / "a.vtu.series")
    (tmp_path / "in" / "p.pvtu").write_text('<VTKFile><PUnstructuredGrid><Piece Source="../f0.vtu"/></x>')
    assert "outside" in str(find_refusal(tmp_path / "in" / "p.pvtu"))
    (tmp_path / "in" / "x.xdmf").write_text('<Xdmf><DataItem Format="HDF">\n ../x.h5:/data0</DataItem></Xdmf>')
    assert "outside" in str(find_refusal(tmp_path / "in" / "x.xdmf"))


# From the command line


def test_a_file_that_kills_its_reader_is_one_line(tmp_path, capfd, monkeypatch):
    make_grid(0).save(tmp_path / "f0.vtu", binary=False)  # for VTK to read
    (tmp_path / "bad.py").write_text(BAD)
    monkeypatch.syspath_prepend(tmp_path)
    genuine, own = Reader.read, Reader()

    def segfaulting(self, function, file, *arguments, error):
        if function.endswith("plain_grid"):
            return genuine(self, "bad:die", file, 11, error=error)
        return genuine(self, function, file, *arguments, error=error)

    monkeypatch.setattr("pipeline.series.files.frame_files.SHARED_READER", own)
    monkeypatch.setattr(Reader, "read", segfaulting)
    assert main(["analyze", str(tmp_path / "f0.vtu"), "--out", str(tmp_path / "out")]) == 2
    out, err = capfd.readouterr()
    assert out == "" and err.count("\n") == 1 and "the reader died (SIGSEGV)" in err
    assert not (tmp_path / "out").exists()
    own.close()


def test_a_mesh_with_a_billion_cells_is_one_line(tmp_path, capfd):
    declared(tmp_path)
    case = write_case(tmp_path, mesh={"file": "f0.vtu"})
    assert main(["check", str(case)]) == 2
    assert "declares 27 points and 1000000000 cells" in capfd.readouterr().err


def test_our_own_frames_need_no_child(tmp_path, monkeypatch):
    from pipeline.case import load_case
    from pipeline.results.case_run import run_case
    from tests.bodies import skip_figures

    skip_figures(monkeypatch)
    run_case(load_case(write_case(tmp_path, variants={"only": {}})), tmp_path / "out", movie=False)
    monkeypatch.setattr(Reader, "read", None)
    folder = tmp_path / "out" / "beam" / "only"
    for file in (folder / "frames").iterdir():  # written inline, nobody's frames need one
        pyvista.read(file).save(file, binary=False)
    assert len(list(read_series(folder))) == 5
    (folder / "run.json").unlink()
    with pytest.raises(TypeError):
        read_series(folder)


def test_meshes_of_meshio_arrive_unchanged(tmp_path):
    meshio.write(tmp_path / "a.msh", meshio.Mesh(make_grid(0).points, [("tetra", CELLS)]), file_format="gmsh")
    mesh = read_mesh(tmp_path / "a.msh")
    assert np.array_equal(mesh.cells, CELLS)


@pytest.mark.parametrize(
    ("name", "old", "new", "words"),
    [
        ("offsets", "4 8 12", "4 9 12", r"cell 1 has 5 nodes, not 4"),
        ("offsets", "4 8 12", "4 8 999", r"the offsets of its 48 cells do not fit their 192 nodes|cannot be read"),
        ("types", "10 10 10", "10 99 10", r"unknown type|cannot be read"),
        ("connectivity", "0 ", "999999 ", r"refers to point 1?999999 of 27|cannot be read|the reader died"),
        ("connectivity", "0 ", "-5 ", r"refers to point|cannot be read|the reader died"),
    ],
)
def test_damaged_cells_are_one_line(tmp_path, name, old, new, words):
    import vtk

    writer = vtk.vtkXMLUnstructuredGridWriter()
    writer.SetFileName(str(tmp_path / "f0.vtu"))
    writer.SetInputData(make_grid(0))
    writer.SetDataModeToAscii()
    writer.Write()
    text = (tmp_path / "f0.vtu").read_text()
    at = text.index(f'Name="{name}"')
    at = text.index(old, text.index(">", at))
    (tmp_path / "f0.vtu").write_text(text[:at] + new + text[at + len(old) :])
    with pytest.raises(SeriesError, match=words) as caught:
        read_series(tmp_path)
    assert "\n" not in str(caught.value)
