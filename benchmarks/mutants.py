"""Mutation test: change one operator or constant of lfref at a time, and see whether a test fails.

Half of the mutants change logic (a comparison, a sign, a product, `and`, `or`), half make a module constant twice or
half as large. Each runs in a copy of the tree: first the test file of its module, then the tests of its package, then
the hostile ones. A seed fixes which mutants are drawn. With `--constants`, each module constant is tried, and no logic.

Usage: python benchmarks/mutants.py [--seed 0] [--number 60] [--workers 2] [--within lfref/captures] [--constants]
"""

import argparse
import ast
import concurrent.futures
import os
import queue
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
COPIED = ("lfref", "conf", "sweeps", "tests", "docs", "pyproject.toml", "README.md", "mkdocs.yml", "Makefile")
# No test can reach these here: they need a GPU, or a package that `make test` leaves out.
LEFT_OUT = ()
TIME_LIMIT_S = 900
SWAPS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.GtE,
    ast.LtE: ast.Gt,
    ast.Gt: ast.LtE,
    ast.GtE: ast.Lt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.And: ast.Or,
    ast.Or: ast.And,
}
SYMBOLS = {
    ast.Lt: "<",
    ast.LtE: "<=",
    ast.Gt: ">",
    ast.GtE: ">=",
    ast.Eq: "==",
    ast.NotEq: "!=",
    ast.Add: "+",
    ast.Sub: "-",
    ast.Mult: "*",
    ast.Div: "/",
    ast.And: "and",
    ast.Or: "or",
}


@dataclass(frozen=True)
class Mutant:
    """One change of one file."""

    file: Path
    """Relative to the repository."""
    line: int
    change: str
    """For people: what becomes what."""
    start: int
    """Offset of the changed bytes in the file."""
    end: int
    text: str
    """What stands there instead."""


def constants(file: Path, source: bytes, tree: ast.Module) -> Iterator[Mutant]:
    """Numbers of module constants, each twice or half as large."""
    for statement in tree.body:
        target = statement.targets[0] if isinstance(statement, ast.Assign) else getattr(statement, "target", None)
        if not isinstance(target, ast.Name) or not target.id.isupper() or statement.value is None:
            continue
        for node in ast.walk(statement.value):
            if isinstance(node, ast.Constant) and type(node.value) in (int, float) and node.value not in (0, 1):
                start, end = span(source, node)
                for factor in (2, 0.5):
                    value = type(node.value)(node.value * factor)
                    if value != node.value:
                        change = f"{target.id}: {node.value} -> {value}"
                        yield Mutant(file, node.lineno, change, start, end, f"({value!r})")


def logic(file: Path, source: bytes, tree: ast.Module) -> Iterator[Mutant]:
    """Operators inside functions, each swapped for its opposite."""
    bodies = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
    skipped = {id(part) for body in bodies for part in not_computed(body)}
    for node in {id(node): node for body in bodies for node in ast.walk(body)}.values():
        if id(node) in skipped:
            continue
        if isinstance(node, ast.Compare) and len(node.ops) == 1:
            parts = (node.left, node.ops[0], node.comparators[0])
        elif isinstance(node, ast.BinOp) and not isinstance(node.left, ast.Constant | ast.JoinedStr):
            parts = (node.left, node.op, node.right)
        elif isinstance(node, ast.BoolOp):
            parts = (node.values[0], node.op, node.values[1])
        else:
            continue
        left, operator, right = parts
        if type(operator) in SWAPS:
            start, end = span(source, left)[1], span(source, right)[0]
            between, symbol = source[start:end].decode(), SYMBOLS[type(operator)]
            if between.count(symbol) == 1:
                other = SYMBOLS[SWAPS[type(operator)]]
                text = between.replace(symbol, other)
                yield Mutant(file, node.lineno, f"{symbol} -> {other}", start, end, text)


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


def span(source: bytes, node: ast.expr) -> tuple[int, int]:
    """Offsets of the first byte of a node and of the one behind its last."""
    lines = source.split(b"\n")
    begin = [0]
    for line in lines:
        begin.append(begin[-1] + len(line) + 1)
    return begin[node.lineno - 1] + node.col_offset, begin[node.end_lineno - 1] + node.end_col_offset


def drawn(seed: int, number: int, within: Path, every_constant: bool) -> list[Mutant]:
    """Mutants of all files: half of them of logic and half of constants, or every constant."""
    kinds: tuple[list[Mutant], list[Mutant]] = ([], [])
    files = [within] if within.is_file() else sorted(within.rglob("*.py"))
    for path in (file for file in files if file.name not in LEFT_OUT):
        source = path.read_bytes()
        tree = ast.parse(source)
        for mutants, kind in zip(kinds, (logic, constants), strict=True):
            mutants.extend(kind(path.relative_to(ROOT), source, tree))
    if every_constant:
        return kinds[1]
    chance = random.Random(seed)
    n_constants = min(number // 2, len(kinds[1]))
    return chance.sample(kinds[0], number - n_constants) + chance.sample(kinds[1], n_constants)


def tests_of(file: Path, tree: Path) -> list[list[str]]:
    """Groups of tests, the nearest to a file first."""
    package = file.relative_to("lfref").parts[0] if len(file.parts) > 2 else ""
    folder = tree / "tests" / package
    nearest = [str(path) for path in sorted(folder.rglob(f"test_{file.stem}*.py"))]
    whole = [str(folder)] if package else [str(path) for path in sorted(folder.glob("test_*.py"))]
    return [group for group in (nearest, whole, [str(tree / "tests" / "hostile")]) if group]


def killed_by(mutant: Mutant, tree: Path) -> str:
    """Which group of tests notices a mutant in a copy of the tree; empty if none does."""
    path = tree / mutant.file
    source = path.read_bytes()
    path.write_bytes(source[: mutant.start] + mutant.text.encode() + source[mutant.end :])
    environment = os.environ | {"PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        for group in tests_of(mutant.file, tree):
            command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *group]
            try:
                run = subprocess.run(
                    command, cwd=tree, env=environment, timeout=TIME_LIMIT_S, stdout=subprocess.PIPE, text=True
                )
            except subprocess.TimeoutExpired:
                return "time limit"
            if run.returncode == 5:  # no tests there
                continue
            if run.returncode != 0:
                failed = [line for line in run.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
                return failed[0].split(" - ")[0].split("::", 1)[-1] if failed else "collection"
    finally:
        path.write_bytes(source)
    return ""


def main() -> None:
    """Try all mutants and print what became of each."""
    parser = argparse.ArgumentParser(description="Mutation test of lfref.")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--number", type=int, default=60)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--within", type=Path, default=ROOT / "lfref", help="a file or folder of the package")
    parser.add_argument("--constants", action="store_true", help="every constant, instead of a sample")
    options = parser.parse_args()
    mutants = drawn(options.seed, options.number, options.within.resolve(), options.constants)
    with tempfile.TemporaryDirectory() as folder:
        trees: queue.Queue[Path] = queue.Queue()
        for number in range(options.workers):
            tree = Path(folder) / str(number)
            for name in COPIED:
                source = ROOT / name
                copy = shutil.copytree if source.is_dir() else shutil.copy
                (tree / name).parent.mkdir(parents=True, exist_ok=True)
                copy(source, tree / name)
            trees.put(tree)

        def attempt(mutant: Mutant) -> str:
            tree = trees.get()
            try:
                return killed_by(mutant, tree)
            finally:
                trees.put(tree)

        with concurrent.futures.ThreadPoolExecutor(options.workers) as pool:
            killers = []
            for mutant, killer in zip(mutants, pool.map(attempt, mutants), strict=True):
                state = "killed  " if killer else "SURVIVED"
                print(f"{state} {mutant.file}:{mutant.line}  {mutant.change}  {killer}", flush=True)
                killers.append(killer)
    print(f"{sum(map(bool, killers))} of {len(mutants)} mutants killed (seed {options.seed})")


if __name__ == "__main__":
    main()
