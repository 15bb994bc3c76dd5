"""``python -m tests.golden.make [NAME ...]``: compute golden values again, all or some, and write where they come from.

It refuses to run on sources that are not committed. What it writes is committed by itself, with the reason.
"""

import csv
import json
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.golden import adapter, values

VALUES = values.HERE / "values"
SOURCES = ("model", "compliant_baselines", "experiments", "impact_xval", "tests/golden")


def git(*arguments):
    """Answer of git, in the root of the checkout."""
    root = values.HERE.parents[1]
    return subprocess.run(
        ["git", *arguments], cwd=root, capture_output=True, text=True, check=True
    ).stdout.strip()


def write_rows(name, rows):
    """Write plain values, one a line; strict JSON."""
    (VALUES / f"{name}.jsonl").write_text("".join(json.dumps(row, allow_nan=False) + "\n" for row in rows))


def write_tables(name, tables):
    """Write tables as CSV files."""
    for table, columns in tables.items():
        with (VALUES / f"{name}-{table}.csv").open("w", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(columns)
            writer.writerows(zip(*columns.values(), strict=True))


def collisions(name):
    """Solve collisions by every exact solver."""
    problems = values.read(f"inputs/{name}.jsonl")
    write_rows(name, (values.golden(p, solver) for p in problems for solver in adapter.EXACT[p["kernel"]]))


def paths(name):
    """Follow collisions, each by its own solver."""
    rows = []
    for problem in values.read(f"inputs/{name}.jsonl"):
        found = adapter.solve(problem, problem["solver"], path=True)
        rows.append({"input": problem["name"], "solver": problem["solver"], "path": found["path"]})
    write_rows(name, rows)


def engines(name):
    """Solve collisions by the engines."""
    problems = values.read(f"inputs/{name}.jsonl")
    rows = (
        {"input": p["name"], "solver": engine, **adapter.solve(p, engine)}
        for p in problems
        for engine in adapter.ENGINES
    )
    write_rows(name, rows)


def tables(name):
    """Run the experiments."""
    for run, spec in values.spec(name).items():
        with tempfile.TemporaryDirectory() as folder:
            write_tables(f"{name}-{run}", adapter.tables(spec, Path(folder)))


def hypothesis(name):
    """Test the hypothesis, a small design and the full one."""
    for design, spec in values.spec(name).items():
        with tempfile.TemporaryDirectory() as folder:
            write_tables(f"{name}-{design}", adapter.hypothesis(spec, Path(folder)))


MAKERS = {
    "two-balls": collisions,
    "lines": collisions,
    "paths": paths,
    "engines": engines,
    "tables": tables,
    "hypothesis": hypothesis,
}


def main(names):
    """Make some golden values, or all."""
    unknown = set(names) - MAKERS.keys()
    if unknown:
        sys.exit(f"{', '.join(sorted(unknown))}: unknown; legal: {', '.join(MAKERS)}")
    dirty = git("status", "--porcelain", "--", *SOURCES, ":(exclude)tests/golden/values")
    if dirty:
        sys.exit(f"sources are not committed, so nobody could make these values again:\n{dirty}")
    VALUES.mkdir(exist_ok=True)
    file = VALUES / "provenance.json"
    provenance = json.loads(file.read_text()) if file.exists() else {}
    for name in names or MAKERS:
        print(name, flush=True)
        MAKERS[name](name)
        provenance[name] = {
            "command": f"python -m tests.golden.make {name}",
            "commit": git("rev-parse", "HEAD"),
            "fingerprint": adapter.fingerprint(),
        }
    file.write_text(json.dumps(provenance, indent=1) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
