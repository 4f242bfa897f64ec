"""Names say one thing each: no type name twice, functions are verbs, no function hides a module of its name."""

import ast
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1] / "pipeline"
TREES = {path: ast.parse(path.read_text(encoding="utf-8")) for path in sorted(PACKAGE.rglob("*.py"))}
# irregular participles, and words in -ed that are none
IRREGULAR = set(
    "begun blown broken brought built chosen drawn driven fallen felt found frozen given gone grown heard held hidden "
    "kept known laid left lost made meant met said seen sent shown spent spoken spun taken thought thrown told "
    "understood worn written".split()
)
NOT_PARTICIPLES = set("bed breed embed exceed feed need proceed seed speed spread succeed".split())


def is_participle(name: str) -> bool:
    word = name.strip("_")
    return "_" not in word and (word in IRREGULAR or (word.endswith("ed") and word not in NOT_PARTICIPLES))


def defined_types(tree: ast.Module) -> Iterator[str]:
    """Classes and aliases at the top of a module: capitalized names that are no constants."""
    for node in tree.body:
        if isinstance(node, ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            name = node.targets[0].id
            if name.lstrip("_")[:1].isupper() and not name.isupper():
                yield name


def test_no_type_name_is_defined_twice():
    places = Counter(name for tree in TREES.values() for name in defined_types(tree))
    assert {name: count for name, count in places.items() if count > 1} == {}


def test_no_function_is_a_bare_participle():
    functions = (
        (f"{path.relative_to(PACKAGE)}:{node.lineno}", node.name)
        for path, tree in TREES.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    )
    assert [f"{place} {name}" for place, name in functions if is_participle(name)] == []


def test_no_module_has_the_name_of_something_beside_it():
    """A name of a package's __init__, or a function of the module itself, would hide the module."""
    hidden = []
    for path, tree in TREES.items():
        if path.name == "__init__.py":
            package = ".".join(path.parent.relative_to(PACKAGE.parent).parts)
            statements = [n for n in tree.body if isinstance(n, ast.ImportFrom) and n.module != package]
            imported = {alias.asname or alias.name for n in statements for alias in n.names}
            modules = {other.stem for other in path.parent.iterdir()}
            hidden += [f"{path.relative_to(PACKAGE)}: {name}" for name in sorted(imported & modules)]
        elif any(isinstance(n, ast.FunctionDef) and n.name == path.stem for n in tree.body):
            hidden.append(f"{path.relative_to(PACKAGE)}: {path.stem}")
    assert hidden == []
