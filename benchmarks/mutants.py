"""Test of the test suite by changes of the physics: seeded mutants of `model/`, the references and their marks.

A mutant is one executable line, drawn uniformly from all, with one change: a comparison, an operator, a sign, a
condition, a number, or a whole statement left out. Each mutant is tried in a copy of the committed files, in three
stages: the golden values, the tests of `model`, and all other tests. A stage ends at the first test that fails, and a
mutant that survives a stage goes to the next one. A mutant takes a minute or two if the golden values reveal it, and as
long as the suite if nothing does.

    python -m benchmarks.mutants --count 24 --seed 1
"""

from __future__ import annotations

import argparse
import ast
import copy
import os
import random
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import Queue

ROOT = Path(__file__).parents[1]
SOURCES = ("model/**/*.py", "compliant_baselines/references.py", "compliant_baselines/marks.py")
STAGES = {
    "golden": ["tests/golden"],
    "model": ["tests/model"],
    "suite": ["tests", "--ignore", "tests/golden", "--ignore", "tests/model"],
}
#: Time limit in s for each stage. Without it a mutant could loop for ever.
LONGEST = {"golden": 600, "model": 1200, "suite": 3600}

_SWAPS: dict[type, type] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult,
    ast.And: ast.Or, ast.Or: ast.And, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
}  # fmt: skip


def statements(tree: ast.Module) -> Iterator[ast.stmt]:
    """Yield simple statements and headers of compound statements; no imports, definitions or docstrings."""
    skipped = ast.Import | ast.ImportFrom | ast.FunctionDef | ast.ClassDef | ast.Pass | ast.Global
    for node in ast.walk(tree):
        if isinstance(node, ast.stmt) and not isinstance(node, skipped):
            text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
            bare = isinstance(node, ast.AnnAssign) and node.value is None
            if not text and not bare:
                yield node


def changes(statement: ast.stmt) -> Iterator[tuple[str, ast.stmt]]:
    """Yield copies of a statement with one change each, and a word for the change.

    Compound statements change in the header.

    A statement is left out only if no later line needs it in order to run: a change of an array, a call.
    """
    blocks = ("body", "orelse", "finalbody", "handlers", "annotation")
    ours = [n for name, part in ast.iter_fields(statement) if name not in blocks for n in _nodes(part)]
    for i, node in enumerate(ours):
        for what, change in _changed(node):
            twin = copy.deepcopy(statement)
            theirs = [n for name, part in ast.iter_fields(twin) if name not in blocks for n in _nodes(part)]
            change(theirs[i])
            yield what, twin
    named = isinstance(statement, ast.Assign) and isinstance(statement.targets[0], ast.Name | ast.Tuple)
    if isinstance(statement, ast.Assign | ast.AugAssign | ast.Expr) and not named:
        yield "left out", ast.copy_location(ast.Pass(), statement)


def _nodes(part: object) -> list[ast.AST]:
    parts = part if isinstance(part, list) else [part]
    return [node for each in parts if isinstance(each, ast.AST) for node in ast.walk(each)]


def _changed(node: ast.AST):
    """Yield the possible changes of a node: a word, and a function that applies the change to a copy."""
    if isinstance(node, ast.Compare) and type(node.ops[0]) in _SWAPS:
        yield "comparison", lambda n: n.ops.__setitem__(0, _SWAPS[type(n.ops[0])]())
    if isinstance(node, ast.BinOp | ast.BoolOp | ast.AugAssign) and type(node.op) in _SWAPS:
        yield "operator", lambda n: setattr(n, "op", _SWAPS[type(n.op)]())
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        yield "sign", lambda n: setattr(n, "op", ast.UAdd())
    if isinstance(node, ast.IfExp):
        yield "branches", lambda n: n.__dict__.update(body=n.orelse, orelse=n.body)
    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        yield "number", lambda n: setattr(n, "value", n.value + 1)
    if isinstance(node, ast.Constant) and type(node.value) is bool:
        yield "truth", lambda n: setattr(n, "value", not n.value)


class _Replaced(ast.NodeTransformer):
    def __init__(self, old: ast.stmt, new: ast.stmt) -> None:
        self.old, self.new = old, new

    def generic_visit(self, node: ast.AST) -> ast.AST:
        """Replace the old statement by the new statement."""
        return self.new if node is self.old else super().generic_visit(node)


def draw(count: int, seed: int) -> Iterator[tuple[Path, int, str, str, str]]:
    """Draw mutants: file, line, a word for the change, the changed statement, and the whole changed file."""
    chance = random.Random(seed)
    trees = {
        path: ast.parse(path.read_text(encoding="utf-8"))
        for pattern in SOURCES
        for path in sorted(ROOT.glob(pattern))
    }
    lines = [(path, statement) for path, tree in trees.items() for statement in statements(tree)]
    found = 0
    for path, statement in chance.sample(lines, len(lines)):
        if found == count:
            return
        if possible := list(changes(statement)):
            what, new = chance.choice(possible)
            tree = trees[path]
            source = ast.unparse(ast.fix_missing_locations(_Replaced(statement, new).visit(tree)))
            _Replaced(new, statement).visit(tree)
            found += 1
            yield path.relative_to(ROOT), statement.lineno, what, ast.unparse(new).splitlines()[0], source


def outcome(folder: Path, path: Path, source: str) -> tuple[str, str]:
    """Put a mutant into a copy of the checkout and run the tests; return the stage that kills it, and the test."""
    before = (folder / path).read_text(encoding="utf-8")
    (folder / path).write_text(source, encoding="utf-8")
    try:
        for stage, places in STAGES.items():
            with tempfile.TemporaryDirectory() as kernels:
                command = [sys.executable, *["-m", "pytest", "-n", "0", "-x", "--tb=no"], *places]
                environment = os.environ | {
                    "NUMBA_CACHE_DIR": kernels,
                    "PYTHONPATH": str(folder),
                    "CI": "true",
                }
                try:
                    done = subprocess.run(
                        command,
                        cwd=folder,
                        env=environment,
                        timeout=LONGEST[stage],
                        capture_output=True,
                        text=True,
                    )
                except subprocess.TimeoutExpired:
                    return stage, "no end"
            if done.returncode < 0:  # the process crashed: a kernel wrote beyond its arrays
                return stage, "crash"
            if done.returncode not in (0, 1, 2):
                raise RuntimeError(f"pytest could not run: {done.stdout}{done.stderr}")
            if done.returncode:
                return stage, "".join(re.findall(r"^(?:FAILED|ERROR) (\S+)", done.stdout, re.M)[:1])
        return "", ""
    finally:
        (folder / path).write_text(before, encoding="utf-8")


def main() -> None:
    """Draw mutants, run the tests on each, and print a line for each."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--count", type=int, default=24)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--processes", type=int, default=2, help="number of mutants that are tested at the same time"
    )
    parser.add_argument("--list", action="store_true", help="print the mutants, and run no tests")
    asked = parser.parse_args()
    mutants = list(draw(asked.count, asked.seed))
    if asked.list:
        for path, line, what, text, _ in mutants:
            print(f"{path}:{line} {what}: {text}")
        return
    copies: Queue[Path] = Queue()
    with tempfile.TemporaryDirectory() as scratch, ThreadPoolExecutor(asked.processes) as pool:
        for i in range(asked.processes):
            subprocess.run(["git", "clone", "-q", ROOT, f"{scratch}/{i}"], check=True)
            copies.put(Path(scratch, str(i)))

        def tried(mutant: tuple[Path, int, str, str, str]) -> bool:
            path, line, what, text, source = mutant
            folder = copies.get()
            stage, test = outcome(folder, path, source)
            copies.put(folder)
            print(f"{stage or 'SURVIVED':8} {path}:{line} {what}: {text}  {test}", flush=True)
            return bool(stage)

        killed = sum(pool.map(tried, mutants))
    print(f"{killed} of {len(mutants)} killed")


if __name__ == "__main__":
    main()
