"""``python -m tests.golden.make [NAME ...]``: compute all or the named golden values again, and record their origin.

It refuses to run if sources are not committed. Commit what it writes separately, with the reason for the change.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import pandas as pd

from tests.golden import adapter, values

VALUES = values.HERE / "values"
SOURCES = ("model", "compliant_baselines", "experiments", "impact_xval", "tests/golden")
NAMES = ("two-balls", "chains", "paths", "engines", "tables", "hypothesis")


def git(*arguments):
    return subprocess.check_output(["git", *arguments], cwd=values.HERE.parents[1], text=True).strip()


def rows(name):
    """Yield golden rows: outcomes by all exact solvers, or one path per collision, or outcomes by the engines."""
    for problem in values.read(f"inputs/{name}.jsonl"):
        if name == "paths":
            path = adapter.solve(problem, problem["solver"], path=True)["path"]
            yield {"input": problem["name"], "solver": problem["solver"], "path": path}
        elif name == "engines":
            for engine in adapter.ENGINES:
                yield {"input": problem["name"], "solver": engine, **adapter.solve(problem, engine)}
        else:
            yield from (values.golden(problem, solver) for solver in adapter.EXACT[problem["kernel"]])


def make(name):
    """Write the golden values of a name: outcomes as strict JSON, one per line, or tables of runs as CSV files."""
    if name not in ("tables", "hypothesis"):
        lines = (json.dumps(row, allow_nan=False) + "\n" for row in rows(name))
        (VALUES / f"{name}.jsonl").write_text("".join(lines))
        return
    for each, spec in values.spec(name).items():
        with tempfile.TemporaryDirectory() as folder:
            for table, columns in getattr(adapter, name)(spec, Path(folder)).items():
                file = VALUES / f"{name}-{each}-{table}.csv"
                pd.DataFrame(columns).to_csv(file, index=False, lineterminator="\n")


def main(names):
    if unknown := set(names) - {*NAMES}:
        sys.exit(f"{', '.join(sorted(unknown))}: unknown; legal: {', '.join(NAMES)}")
    if dirty := git("status", "--porcelain", "--", *SOURCES, ":(exclude)tests/golden/values"):
        sys.exit(f"sources are not committed, so nobody could make these values again:\n{dirty}")
    provenance = values.provenance()
    for name in names or NAMES:
        print(name, flush=True)
        make(name)
        command, commit = f"python -m tests.golden.make {name}", git("rev-parse", "HEAD")
        provenance[name] = {"command": command, "commit": commit}
    values.PROVENANCE.write_text(json.dumps(provenance, indent=1) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
