"""Test of runs that are ended in their first seconds: the same command must continue each to the same tables.

``python benchmarks/first_seconds.py [--instants 40] [--until 10] [--ends SIGINT SIGINT+SIGINT SIGTERM SIGKILL]``
    Each run is ended at an instant by signals of one kind; two signals are a hundredth of a second apart. A run counts
    as faulty if it shows a traceback, or ends otherwise than with one line and exit code 1 (0 if it was faster), or is
    refused by the same command, or does not complete, or has tables that differ in a byte from those of an undisturbed
    run.

The command sets its handlers some tens of milliseconds after its process began. Before, Python itself answers Ctrl-C by
a traceback. So the instants begin at the time at which a Python process that does nothing would have ended.
"""

from __future__ import annotations

import argparse
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

EXPERIMENT = """
scenario = "impact"
solvers = ["bistiffness", "mujoco"]
chunk_size = 2
[grid]
stiffness_ratio = [0.5, 1.0, 2.0]
mass_ratio = [1.0, 1.5]
e1 = [0.9]
e2 = [0.7]
"""
#: Time in s between two signals, and longest time in s that a run may take.
_BETWEEN, _LIMIT = 0.01, 300.0


def command(folder: Path, root: Path) -> list[str]:
    """Return the command that runs the experiment in `folder` and writes its tables to `root`."""
    words = ["run", str(folder / "few.toml"), "--out", str(root), "--workers", "1"]
    return [sys.executable, "-m", "impact_xval", *words]


def ended(words: list[str], instant: float, ends: list[signal.Signals]) -> tuple[int, str]:
    """Send signals to a command at an instant in s after it began; return its exit code and its standard error."""
    process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    time.sleep(instant)
    for end in ends:
        process.send_signal(end)
        time.sleep(_BETWEEN)
    _, error = process.communicate(timeout=_LIMIT)
    return process.returncode, error


def tables(root: Path) -> dict[str, bytes]:
    """Return the bytes of every table in the folder of a run, by file name."""
    return {path.name: path.read_bytes() for path in root.iterdir() if path.suffix in (".csv", ".parquet")}


def found(folder: Path, instant: float, ends: list[signal.Signals], whole: dict[str, bytes]) -> list[str]:
    """Return the faults of a run that was ended at an instant, and of its continuation."""
    with tempfile.TemporaryDirectory(dir=folder) as name:
        root = Path(name) / "run"
        code, error = ended(command(folder, root), instant, ends)
        wrong = ["a traceback"] if "Traceback" in error or "Exception ignored" in error else []
        if code not in ((-signal.SIGKILL, 0) if signal.SIGKILL in ends else (0, 1)):
            wrong.append(f"exit code {code}")
        if code == 1 and not ("interrupted" in error and error.count("\n") == 1):
            wrong.append("not one line")
        again = subprocess.run(
            command(folder, root), capture_output=True, text=True, check=False, timeout=_LIMIT
        )
        if again.returncode:
            wrong.append("refused")
            error += again.stderr
        elif tables(root) != whole:
            wrong.append("other tables")
        left = [path.name for path in root.rglob(".tmp-*")]
        if left:
            wrong.append("half a file left")
        if wrong:
            Console(stderr=True).print(f"{instant:.2f} s: {', '.join(wrong)}\n{error}", markup=False)
        return wrong


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--instants", type=int, default=40)
    parser.add_argument("--until", type=float, default=10.0, help="latest instant, in s after the run began")
    ends = ["SIGINT", "SIGINT+SIGINT", "SIGTERM", "SIGTERM+SIGINT", "SIGKILL"]
    parser.add_argument("--ends", nargs="+", default=ends)
    asked = parser.parse_args()
    console, table = Console(width=120), Table("ended by", "instants", "went on to the same tables", "wrong")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "few.toml").write_text(EXPERIMENT, encoding="utf-8")
        start = time.perf_counter()
        subprocess.run([sys.executable, "-c", "import typing"], check=True)
        first = time.perf_counter() - start
        start = time.perf_counter()
        subprocess.run(command(folder, folder / "whole"), check=True, stdout=subprocess.DEVNULL)
        console.print(
            f"left alone a run takes {time.perf_counter() - start:.1f} s; instants begin at {first:.2f} s"
        )
        whole = tables(folder / "whole")
        outcomes: dict[str, list[list[str]]] = {kind: [] for kind in asked.ends}
        for instant in np.linspace(first, asked.until, asked.instants):
            for kind, known in outcomes.items():
                numbers = [signal.Signals[each] for each in kind.split("+")]
                known.append(found(folder, instant, numbers, whole))
                console.print(
                    f"{instant:.2f} s, {kind}: {', '.join(known[-1]) or 'went on to the same tables'}"
                )
    for kind, known in outcomes.items():
        wrong = Counter(word for words in known for word in words)
        right = sum(not {"refused", "other tables"} & {*words} for words in known)
        table.add_row(
            kind, str(len(known)), str(right), ", ".join(f"{n} {word}" for word, n in wrong.items())
        )
    console.print(table)


if __name__ == "__main__":
    main()
