"""Checks of the package that take long or need a whole tree: mutants of its code, and how far a reader walks.

`checks.py mutants` changes one operator or constant of lfref at a time, and sees whether a test fails. Half of the
mutants change logic (a comparison, a sign, a product, `and`, `or`), half make a module constant twice or half as large.
Each runs in a copy of the tree: first the test file of its module, then the tests of its package, then the hostile
ones. A seed fixes which mutants are drawn. With `--constants`, each module constant is tried, and no logic.

`checks.py walk` counts files and functions of lfref that run, and prints the deepest chain of calls, for
`lfref.load()(views, slopes)` and `lfref refocus FILE`, without what merely loads modules.
"""

import argparse
import ast
import concurrent.futures
import inspect
import os
import random
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import CodeType, FrameType
from typing import Any, NamedTuple

import pages
import torch
from pages import ROOT

import lfref
from lfref.cli.main import main as start

# Mutants

NOT_COPIED = shutil.ignore_patterns(".*", "runs", "outputs", "multirun", "__pycache__")
TIME_LIMIT_S = 900
SWAPS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.GtE,
    ast.LtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.Add: ast.Sub,
    ast.Mult: ast.Div,
    ast.And: ast.Or,
}
SWAPS |= {after: before for before, after in SWAPS.items()}


class Mutant(NamedTuple):
    """One change of one file."""

    file: Path
    """Relative to the repository."""
    line: int
    node: int
    """Place of the changed node in the walk of the file's tree."""
    field: str
    value: Any
    change: str
    """For people: what becomes what."""

    def text(self, source: str) -> str:
        """The changed file."""
        tree = ast.parse(source)
        setattr(list(ast.walk(tree))[self.node], self.field, self.value)
        return ast.unparse(tree)


def constants(file: Path, tree: ast.Module) -> Iterator[Mutant]:
    """Numbers of module constants, each twice or half as large."""
    places = {id(node): place for place, node in enumerate(ast.walk(tree))}
    for statement in tree.body:
        target = statement.targets[0] if isinstance(statement, ast.Assign) else getattr(statement, "target", None)
        if not isinstance(target, ast.Name) or not target.id.isupper() or statement.value is None:
            continue
        for node in ast.walk(statement.value):
            if isinstance(node, ast.Constant) and type(node.value) in (int, float) and node.value not in (0, 1):
                for value in (type(node.value)(node.value * factor) for factor in (2, 0.5)):
                    if value != node.value:
                        change = f"{target.id}: {node.value} -> {value}"
                        yield Mutant(file, node.lineno, places[id(node)], "value", value, change)


def logic(file: Path, tree: ast.Module) -> Iterator[Mutant]:
    """Operators inside functions, each swapped for its opposite."""
    bodies = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
    inside = {id(node) for body in bodies for node in ast.walk(body)}
    skipped = {id(part) for body in bodies for part in not_computed(body)}
    for place, node in enumerate(ast.walk(tree)):
        if id(node) not in inside or id(node) in skipped:
            continue
        if isinstance(node, ast.Compare) and len(node.ops) == 1:
            field, operator = "ops", node.ops[0]
        elif isinstance(node, ast.BoolOp) or (
            isinstance(node, ast.BinOp) and not isinstance(node.left, ast.Constant | ast.JoinedStr)
        ):
            field, operator = "op", node.op
        else:
            continue
        if (swap := SWAPS.get(type(operator))) is not None:
            change = f"{type(operator).__name__} -> {swap.__name__}"
            yield Mutant(file, node.lineno, place, field, [swap()] if field == "ops" else swap(), change)


def not_computed(function: ast.FunctionDef) -> Iterator[ast.AST]:
    """Parts of a function that compute nothing a test could see: annotations, and the texts of errors."""
    arguments = [*function.args.args, *function.args.kwonlyargs]
    for part in [function.returns, *(argument.annotation for argument in arguments)]:
        yield from ast.walk(part) if part is not None else ()
    for node in ast.walk(function):
        if isinstance(node, ast.Raise | ast.JoinedStr):
            yield from ast.walk(node)
        if isinstance(node, ast.AnnAssign):
            yield from ast.walk(node.annotation)


def drawn(seed: int, number: int, within: Path, every_constant: bool) -> list[Mutant]:
    """Mutants of all files: half of them of logic and half of constants, or every constant."""
    files = [within] if within.is_file() else sorted(within.rglob("*.py"))
    trees = {path.relative_to(ROOT): ast.parse(path.read_text("utf-8")) for path in files}
    of_logic, of_constants = ([each for item in trees.items() for each in kind(*item)] for kind in (logic, constants))
    if every_constant:
        return of_constants
    chance = random.Random(seed)
    n_constants = min(number // 2, len(of_constants))
    return chance.sample(of_logic, number - n_constants) + chance.sample(of_constants, n_constants)


def killed_by(mutant: Mutant, tree: Path) -> str:
    """Which test notices a mutant in a copy of the tree; empty if none does."""
    path, package = tree / mutant.file, mutant.file.parts[1] if len(mutant.file.parts) > 2 else ""
    folder = tree / "tests" / package
    nearest = sorted(folder.rglob(f"test_{mutant.file.stem}*.py"))
    groups = [nearest, [folder] if package else sorted(folder.glob("test_*.py")), [tree / "tests" / "hostile"]]
    environment = os.environ | {"PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"}
    source = path.read_text("utf-8")
    path.write_text(mutant.text(source), "utf-8")
    try:
        for group in filter(None, groups):
            command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *map(str, group)]
            run = subprocess.run(
                command, cwd=tree, env=environment, timeout=TIME_LIMIT_S, stdout=subprocess.PIPE, text=True
            )
            if run.returncode not in (0, 5):  # 5: no tests there
                failed = [line for line in run.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
                return failed[0].split(" - ")[0].split("::", 1)[-1] if failed else "collection"
    except subprocess.TimeoutExpired:
        return "time limit"
    finally:
        path.write_text(source, "utf-8")
    return ""


def try_mutants(mutants: list[Mutant], n_workers: int) -> None:
    """Try all mutants and print what became of each."""
    n_killed, own = 0, threading.local()
    with tempfile.TemporaryDirectory() as folder:

        def copy_tree() -> None:
            own.tree = shutil.copytree(ROOT, Path(tempfile.mkdtemp(dir=folder), "tree"), ignore=NOT_COPIED)

        with concurrent.futures.ThreadPoolExecutor(n_workers, initializer=copy_tree) as pool:
            killers = pool.map(lambda mutant: killed_by(mutant, own.tree), mutants)
            for mutant, killer in zip(mutants, killers, strict=True):
                state = "killed  " if killer else "SURVIVED"
                print(f"{state} {mutant.file}:{mutant.line}  {mutant.change}  {killer}", flush=True)
                n_killed += bool(killer)
    print(f"{n_killed} of {len(mutants)} mutants killed")


# Walks

PACKAGE = str(ROOT / "lfref") + "/"


def walk(use: str, run: Callable[[], object]) -> None:
    """Print how many files and functions of lfref run, and the deepest chain of calls."""
    functions: set[CodeType] = set()
    deepest: list[str] = []

    def record(frame: FrameType | None, event: str, _: object) -> None:
        if event != "call" or frame is None or not is_ours(frame.f_code):
            return
        code, chain = frame.f_code, []
        while frame is not None:
            if frame.f_code.co_filename.startswith(PACKAGE) and frame.f_code.co_name == "<module>":
                return  # a module that is loaded makes its constants
            if is_ours(frame.f_code):
                chain.append(f"{frame.f_code.co_filename.removeprefix(PACKAGE)}:{frame.f_code.co_qualname}")
            frame = frame.f_back
        functions.add(code)
        if len(chain) > len(deepest):
            deepest[:] = chain[::-1]

    threading.setprofile(record)
    sys.setprofile(record)
    try:
        run()
    finally:
        sys.setprofile(None)
        threading.setprofile(None)
    names = {(code.co_filename, code.co_qualname) for code in functions if code.co_name[0] != "<"}
    n_files = len({code.co_filename for code in functions})
    print(f"{use}: {n_files} files, {len(names)} functions, {len(deepest)} calls deep", *deepest, sep="\n  ")


def is_ours(code: CodeType) -> bool:
    """Whether it is a function of lfref, and no module or body of a class."""
    return code.co_filename.startswith(PACKAGE) and bool(code.co_flags & inspect.CO_OPTIMIZED)


def walk_all() -> None:
    """`lfref.load()(views, slopes)`, the network that ships, and `lfref refocus FILE` on a simulated light field."""
    views = torch.rand(7, 7, 3, 64, 64, generator=torch.Generator().manual_seed(0))
    walk("load", lambda: lfref.load()(views, [-7, -3, 0.5]))
    with tempfile.TemporaryDirectory() as folder:
        size = "scene.camera.size=[96,128]"
        pages.lfref("simulate", "n_fields=1", size, "outputs=[views]", "seed=1", f"output={folder}/scene")
        sys.argv = ["lfref", "refocus", f"{folder}/scene/simulated_s1_e0_000", f"output={folder}/stack"]
        walk("refocus", start)


def main() -> None:
    """Try mutants, or walk."""
    parser = argparse.ArgumentParser(description="Mutants of lfref, and how far a reader walks.")
    commands = parser.add_subparsers(dest="command", required=True)
    mutants = commands.add_parser("mutants")
    mutants.add_argument("--seed", type=int, default=0)
    mutants.add_argument("--number", type=int, default=60)
    mutants.add_argument("--workers", type=int, default=2)
    mutants.add_argument("--within", type=Path, default=ROOT / "lfref", help="a file or folder of the package")
    mutants.add_argument("--constants", action="store_true", help="every constant, instead of a sample")
    commands.add_parser("walk")
    options = parser.parse_args()
    if options.command == "walk":
        walk_all()
    else:
        within = options.within.resolve()
        try_mutants(drawn(options.seed, options.number, within, options.constants), options.workers)


if __name__ == "__main__":
    main()
