"""Whether the tests of the model see a change of the model: seeded mutants of `model/`, and which test kills each.

A mutant is one place of the source changed by an operator of Cosmic Ray (a sign, a comparison, a number, a condition).
Places are drawn at random, then one change of each; what changes annotations alone, or takes away a decorator, which
compiles and does nothing else, is passed over. Kernels are interpreted. Tests run until the first that fails; a mutant
with which they take ten times as long as without one is killed by time. Hours on two cores.

    pip install cosmic-ray
    python -m benchmarks.mutants --count 300 --seed 1 --out mutants.csv
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from itertools import count
from pathlib import Path
from queue import Queue

import pandas as pd

ROOT = Path(__file__).parents[1]
TESTS = ("tests/model", "tests/published")
#: Not drawn: what changes nothing, and operators of bits, which any test kills, for floats have none.
PASSED_OVER = re.compile(
    "core/(NoOp|RemoveDecorator|ReplaceBinaryOperator_.*_(BitAnd|BitOr|BitXor|LShift|RShift))"
)


class WithoutAnnotations(ast.NodeTransformer):
    """What a module does: its tree without annotations."""

    def visit_arg(self, node: ast.arg) -> ast.AST:
        """Drop that of an argument."""
        return ast.arg(node.arg)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        """Drop that of what is returned."""
        node.returns = None
        return self.generic_visit(node)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST | None:
        """Drop that of a variable."""
        if node.value is None:
            return ast.Expr(node.target)
        return ast.Assign([node.target], node.value)


def meaning(source: str) -> str | None:
    """Return a text that two sources share if they differ in annotations at most; None if it is no Python."""
    try:
        return ast.dump(WithoutAnnotations().visit(ast.parse(source)))
    except SyntaxError:
        return None


def places(modules: list[Path]) -> dict[tuple, list[tuple]]:
    """Return the changes (module, operator, occurrence) of each place (module, start, end)."""
    from cosmic_ray.ast import ast_nodes, get_ast_from_path
    from cosmic_ray.plugins import get_operator, operator_names

    found: dict[tuple, list[tuple]] = {}
    for module in modules:
        tree = get_ast_from_path(module)
        for name in sorted(operator_names()):
            if PASSED_OVER.fullmatch(name) or get_operator(name).arguments():
                continue  # arguments are names of variables
            numbers = count()
            for node in ast_nodes(tree):
                for start, end in get_operator(name)().mutation_positions(node):
                    found.setdefault((module, start, end), []).append((module, name, next(numbers)))
    return found


def drawn(number: int, seed: int) -> list[tuple[Path, str, tuple, str]]:
    """Mutants (module, operator, place, source), as many as were asked for."""
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.plugins import get_operator

    chance = random.Random(seed)
    sites = places(sorted((ROOT / "model").rglob("*.py")))
    mutants = []
    for site in chance.sample(sorted(sites), len(sites)):
        module, operator, occurrence = chance.choice(sites[site])
        source = module.read_text(encoding="utf-8")
        changed = mutate_code(source, get_operator(operator)(), occurrence)
        if changed is not None and meaning(changed) not in (None, meaning(source)):
            mutants.append((module.relative_to(ROOT), operator, site[1], changed))
        if len(mutants) == number:
            break
    return mutants


def copy_of_the_checkout(folder: Path) -> Path:
    """Copy what is tracked, as it is now, to change it there."""
    files = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True
    ).stdout.decode()
    for name in filter(None, files.split("\0")):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, folder / name, follow_symlinks=False)
    return folder


def run_tests(folder: Path, seconds: float | None, *options: str) -> tuple[str, str]:
    """Run the tests in a copy: what became of it (killed, timeout, survived), and the output."""
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONDONTWRITEBYTECODE": "1", "CI": "true"}
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-n",
        "0",
        "-x",
        "--tb=line",
        "-p",
        "no:cacheprovider",
        *options,
        *TESTS,
    ]
    try:
        done = subprocess.run(
            command, cwd=folder, env=environment, timeout=seconds, capture_output=True, text=True
        )
    except subprocess.TimeoutExpired:
        return "timeout", ""
    return "killed" if done.returncode else "survived", done.stdout


def main() -> int:
    """Draw mutants, run the tests on each, and write what became of them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--count", type=int, default=300, help="mutants (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="of what is drawn (default: %(default)s)")
    parser.add_argument("--processes", type=int, default=2, help="side by side (default: %(default)s)")
    parser.add_argument("--out", type=Path, default=Path("mutants.csv"), help="table (default: %(default)s)")
    parser.add_argument("-k", dest="tests", default="", help="tests, as pytest -k; all without")
    options = parser.parse_args()
    chosen = ("-k", options.tests) if options.tests else ()
    mutants, rows = drawn(options.count, options.seed), []
    with tempfile.TemporaryDirectory() as scratch, ThreadPoolExecutor(options.processes) as pool:
        copies: Queue[Path] = Queue()
        for i in range(options.processes):
            copies.put(copy_of_the_checkout(Path(scratch) / str(i)))
        start = time.perf_counter()
        became, output = run_tests(Path(scratch) / "0", None, *chosen)
        if became != "survived":
            print(f"the tests fail without a mutant:\n{output}")
            return 1
        alone = time.perf_counter() - start
        print(f"{len(mutants)} mutants; tests without one take {alone:.0f} s", flush=True)

        def tried(mutant: tuple[Path, str, tuple, str]) -> None:
            module, operator, (line, column), source = mutant
            folder = copies.get()
            before = (folder / module).read_text(encoding="utf-8")
            (folder / module).write_text(source, encoding="utf-8")
            start = time.perf_counter()
            became, output = run_tests(folder, 10 * alone, *chosen)
            seconds = time.perf_counter() - start
            (folder / module).write_text(before, encoding="utf-8")
            copies.put(folder)
            test = "".join(re.findall(r"^(?:FAILED|ERROR) (\S+)", output, re.M)[:1])
            was, now = (text.splitlines()[line - 1].strip() for text in (before, source))
            rows.append(
                (module.as_posix(), line, column, operator, became, test, round(seconds, 1), was, now)
            )
            print(f"{len(rows)} {became} {module}:{line} {operator} {seconds:.0f} s {test}", flush=True)
            names = ["module", "line", "column", "operator", "became", "test", "seconds", "was", "is"]
            pd.DataFrame(rows, columns=names).sort_values(["module", "line", "column"]).to_csv(
                options.out, index=False
            )

        list(pool.map(tried, mutants))
    survived = sum(row[4] == "survived" for row in rows)
    print(f"killed: {len(rows) - survived} of {len(rows)}, {1 - survived / len(rows):.1%}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
