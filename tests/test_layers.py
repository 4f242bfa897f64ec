"""The layout holds: rooms import upwards only, files and functions stay small, heavy packages come late."""

import ast
import io
import subprocess
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "pipeline"
XARRAY_PLUGIN = PACKAGE / "series" / "xarray_plugin.py"
FILES = sorted(PACKAGE.rglob("*.py"))
# A module imports only from its own room and rooms before it; `__init__` is what `import pipeline` gives.
ROOMS = (
    "errors arrays system case formats mesh fem linear stepping problem run sinks series analysis views results "
    "studies __init__ cli"
).split()
HEAVY = frozenset(
    "pyvista vtk vtkmodules meshio xarray netCDF4 matplotlib numba rich imageio_ffmpeg PIL pandas h5py adios2 k3d dask "
    "distributed felupe mujoco".split()
)
MAX_FILE_LINES = 400
MAX_FUNCTION_LINES = 45  # of code: docstrings, comments and blank lines are free


def module_name(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts)


def room(module: str) -> str:
    """Room of a module of ours; the package itself, or a name it defines, is `__init__`."""
    parts = module.split(".")
    return parts[1] if len(parts) > 1 and parts[1] in ROOMS else "__init__"


def parse(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), str(path))


def imported(tree: ast.AST, module: str) -> Iterator[tuple[int, str]]:
    """Line and absolute name of everything imported anywhere below `tree`, relative imports resolved."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = module.split(".")[: -node.level] if node.level else []
            start = ".".join([*base, *([node.module] if node.module else [])])
            yield from ((node.lineno, f"{start}.{alias.name}") for alias in node.names)


def misplaced(tree: ast.AST, module: str) -> list[str]:
    """The imports of `module` that come from a later room."""
    own = ROOMS.index(room(module))
    ours = [(line, name) for line, name in imported(tree, module) if name.split(".")[0] == "pipeline"]
    return [f"line {line}: {name}" for line, name in ours if ROOMS.index(room(name)) > own]


def at_import(node: ast.AST) -> Iterator[ast.stmt]:
    """Import statements that run when the module is imported: not those in functions or for types only."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Import | ast.ImportFrom):
            yield child
        elif isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
            for statement in child.orelse:
                yield from at_import(ast.Module([statement], []))
        elif not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            yield from at_import(child)


def without_main(tree: ast.Module) -> ast.Module:
    """The module less its `if __name__ == "__main__"` part and the `main` that this calls."""
    guards = [n for n in tree.body if isinstance(n, ast.If) and "__name__" in ast.unparse(n.test)]
    dropped = [*guards, *(n for n in tree.body if guards and getattr(n, "name", None) == "main")]
    return ast.Module([n for n in tree.body if n not in dropped], [])


def code_lines(source: str) -> set[int]:
    """Numbers of the lines that hold code."""
    passive = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT)
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in passive and token.type != tokenize.ENDMARKER:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(source)):  # docstrings
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            lines -= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return lines


@pytest.mark.parametrize("path", FILES, ids=module_name)
def test_imports_come_from_rooms_above(path):
    relative = path.relative_to(PACKAGE)
    assert relative.parts[0].removesuffix(".py") in ROOMS, f"{relative} is in no room of the list"
    assert misplaced(parse(path), module_name(path)) == []


@pytest.mark.parametrize("path", FILES, ids=module_name)
def test_only_the_command_line_prints_and_exits(path):
    name = module_name(path)
    if room(name) == "cli":
        return
    tree = without_main(parse(path)) if name == "pipeline.system.opengl" else parse(path)
    calls = [(n.lineno, ast.unparse(n.func)) for n in ast.walk(tree) if isinstance(n, ast.Call)]
    loud = {"print", "sys.exit", "exit", "quit", "os._exit"}
    assert [f"line {line}: {call}" for line, call in calls if call in loud] == []


@pytest.mark.parametrize("path", FILES, ids=module_name)
def test_files_and_functions_stay_small(path):
    source = path.read_text(encoding="utf-8")
    assert len(source.splitlines()) <= MAX_FILE_LINES
    code = code_lines(source)
    functions = [n for n in ast.walk(ast.parse(source)) if isinstance(n, ast.FunctionDef)]
    sizes = {f.name: len(code & set(range(f.lineno, (f.end_lineno or 0) + 1))) for f in functions}
    assert {name: size for name, size in sizes.items() if size > MAX_FUNCTION_LINES} == {}


@pytest.mark.parametrize("path", FILES, ids=module_name)
def test_heavy_packages_are_imported_where_they_are_used(path):
    # kernels are decorated by numba; the plugin is loaded by xarray's entry point only
    allowed = {"numba"} if path.parent.name == "kernels" else {"xarray"} if path == XARRAY_PLUGIN else set()
    statements = ast.Module(list(at_import(parse(path))), [])
    tops = {name.split(".")[0] for _, name in imported(statements, module_name(path))}
    assert tops & HEAVY - allowed == set()


def test_importing_the_package_costs_nothing_heavy():
    use = "import pipeline, sys; [getattr(pipeline, name) for name in pipeline.__all__]"
    code = f"{use}; print(*sorted({{name.split('.')[0] for name in sys.modules}}))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert set(run.stdout.split()) & HEAVY == set()


@pytest.mark.parametrize(
    ("module", "source", "count"),
    [
        ("pipeline.fem.body", "from pipeline.mesh.simplex import Mesh", 0),
        ("pipeline.fem.body", "from pipeline.fem import laws", 0),
        ("pipeline.fem.body", "from ..stepping import state", 1),
        ("pipeline.fem.body", "from .laws import Linear\nfrom .. import run", 1),
        ("pipeline.mesh", "import pipeline.views.movie.movie", 1),
        ("pipeline.case", "def f():\n    from pipeline import build, errors", 1),
        ("pipeline.run.frame_iterator", "from pipeline import load_case", 1),
        ("pipeline.cli", "from pipeline import load_case\nfrom pipeline.studies import scaling", 0),
    ],
)
def test_the_rule_sees_what_it_should(module, source, count):
    assert len(misplaced(ast.parse(source), module)) == count


def import_graph() -> dict[str, set[str]]:
    """The modules that each module imports anywhere, within functions too."""
    modules = {module_name(path).removesuffix(".__init__"): path for path in FILES}
    graph = {}
    for name, path in modules.items():
        if name == "pipeline":  # its face
            continue
        names = {target for _, target in imported(parse(path), module_name(path))}
        found = {target if target in modules else target.rpartition(".")[0] for target in names}
        graph[name] = (found & modules.keys()) - {name, "pipeline"}
    return graph


def test_no_files_import_each_other_in_a_circle():
    graph = import_graph()
    while leaves := [name for name, targets in graph.items() if not targets & graph.keys()]:
        for name in leaves:
            del graph[name]
    assert graph == {}, "these import each other, or what does"
