"""No module of the package needs itself, not even by way of imports inside functions or modules loaded by name."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.conftest import ROOT

LOADERS = {"import_module", "__import__"}


def imported(tree: ast.AST, known: set[str]) -> Iterator[str]:
    """Known modules that a module imports anywhere in it; where it loads modules by name, all that it names."""
    nodes = list(ast.walk(tree))
    loads_by_name = any(LOADERS & {getattr(node, "id", None), getattr(node, "attr", None)} for node in nodes)
    for node in nodes:
        match node:
            case ast.Import(names=names):
                yield from (alias.name for alias in names if alias.name in known)
            case ast.ImportFrom(module=str(origin), names=names):
                inside = {f"{origin}.{alias.name}" for alias in names}
                yield from inside & known
                if inside - known and origin in known:  # a name within that module
                    yield origin
            case ast.Constant(value=str(name)) if loads_by_name and name in known:
                yield name


def modules(package: Path) -> dict[str, set[str]]:
    """What each module of a package imports of it."""
    files = {".".join(file.relative_to(package.parent).with_suffix("").parts): file for file in package.rglob("*.py")}
    files = {name.removesuffix(".__init__"): file for name, file in files.items()}
    return {name: set(imported(ast.parse(file.read_text()), set(files))) for name, file in files.items()}


def circle(needs: dict[str, set[str]]) -> list[str]:
    """Modules that need each other, if there are such: what is left when all that need nothing are taken away."""
    left = dict(needs)
    while done := {name for name, others in left.items() if not others & left.keys()}:
        left = {name: others for name, others in left.items() if name not in done}
    return sorted(left)


def test_the_package_has_no_circle():
    needs = modules(ROOT / "lfref")
    del needs["lfref"]  # the public front: it loads by name what a user asks for, and nobody inside asks it
    assert circle(needs) == []


@pytest.mark.parametrize(
    "back", ["def f():\n    from house.a import X", "import importlib\nROOM = 'house.a'\nimportlib.import_module(ROOM)"]
)
def test_every_way_of_closing_a_circle_is_noticed(tmp_path, back):
    (tmp_path / "house").mkdir()
    texts = {"__init__": "", "a": "from house import b\nX = 1", "b": "import house.c", "c": back, "d": "import house.a"}
    for name, text in texts.items():
        (tmp_path / "house" / f"{name}.py").write_text(text)
    assert set(circle(modules(tmp_path / "house"))) >= {"house.a", "house.b", "house.c"}
