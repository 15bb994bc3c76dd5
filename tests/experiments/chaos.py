"""Faults drawn at random against small real runs: ``python -m tests.experiments.chaos --faults 200 --seed 1``.

A run is begun, something is done to it or to its folder, it is resumed, and so on; then it is left alone until it is
complete. Its tables must be those of a run that nothing was done to, byte by byte. Whatever happened, no process of
it may be left, none may have listened beyond loopback, and what it said may hold no traceback. Among its solvers is
one that misbehaves in cells of its own, in ways that a run must tell apart from what is done from outside.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
import uuid
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import psutil
import pyarrow.parquet as pq

from impact_xval.experiments.tables.store import TABLES
from tests.compliant_baselines.third_party import install

ROOT = Path(__file__).parents[2]
#: Cells of a run, of its chunks, and faults of it at most.
CELLS, CHUNK, FAULTS = 24, 3, 10
CONFIG = f"""
scenario = "impact"
solvers = ["mujoco", "hostile"]
step_fraction = 0.005
chunk_size = {CHUNK}
cell_timeout = 20
[convergence]
enabled = false
[grid]
stiffness_ratio = {{log = [0.02, 30, {CELLS}]}}
mass_ratio = [1.0]
e1 = [0.7]
e2 = [0.6]
"""

HOSTILE = """
import os, signal, sys
from dataclasses import replace
from impact_xval.compliant_baselines.contract.solver import SolverBase
from impact_xval.model import solve

WRONG = {
    3: lambda o: replace(o, v1="fast"),
    11: lambda o: replace(o, reason=["\\ud800"], status="timeout"),
    13: lambda o: lambda: o,
    17: lambda o: os.kill(os.getpid(), signal.SIGSEGV),
    19: lambda o: sys.exit(3),
    23: lambda o: 1 / 0,
}


class Hostile(SolverBase):
    name = "hostile"

    def version(self):
        return "1"

    def solve_many(self, collisions, settings):
        numbers = (round(1000 * c.k2 / c.k1 + 10 * c.m2 / c.m1 + 100 * c.e2) for c in collisions)
        kinds = (WRONG.get(number % 27, lambda o: o) for number in numbers)
        return [kind(replace(solve(c), solver=self.name)) for kind, c in zip(kinds, collisions)]
"""

#: Seconds in which what a run started must be gone after it, and in which a run left alone must end.
GONE, LONGEST = 10.0, 300.0
MARK = "IMPACT_XVAL_CHAOS"

Rng = random.Random


def marked(variable: str, mark: str) -> list[psutil.Process]:
    """Processes that live and have a mark in their environment: whatever was started with it."""
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error, OSError):
            if process.environ().get(variable) == mark and process.status() != psutil.STATUS_ZOMBIE:
                found.append(process)
    return found


class Run:
    """A run in a folder, begun again and again; `said` is all that it wrote to standard error."""

    def __init__(self, config: Path, root: Path, env: dict[str, str]) -> None:
        self.root, self._config, self._mark = root, config, uuid.uuid4().hex
        self._env = {**env, MARK: self._mark}
        self._log = root.with_suffix(".log")
        self.process: subprocess.Popen[bytes] | None = None
        self.clock_moved = False

    def start(self) -> None:
        words = ["run", self._config, "--out", self.root, "--workers", "2"]
        words += ["--resume"] if (self.root / "manifest.json").exists() else []
        words += ["--take-over"] if self.clock_moved else []
        with self._log.open("ab") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "impact_xval", *map(str, words)],
                cwd=ROOT, env=self._env, stdout=log, stderr=log, preexec_fn=_hear_all,
            )  # fmt: skip

    def processes(self) -> list[psutil.Process]:
        """Whatever runs with the mark of this run, children of children among them; the main process first."""
        main = self.process.pid if self.process is not None else 0
        return sorted(marked(MARK, self._mark), key=lambda p: (p.pid != main, p.pid))

    def listening(self) -> set[str]:
        """Addresses beyond loopback on which any process of the run listens."""
        addresses = set()
        for process in self.processes():
            with contextlib.suppress(psutil.Error):
                for each in process.net_connections("inet"):
                    if each.status == psutil.CONN_LISTEN and each.laddr.ip not in ("127.0.0.1", "::1"):
                        addresses.add(f"{each.laddr.ip}:{each.laddr.port}")
        return addresses

    def orphans(self) -> list[str]:
        """Processes that are left `GONE` seconds after the main one ended."""
        end = time.monotonic() + GONE
        while self.processes() and time.monotonic() < end:
            time.sleep(0.05)
        return [f"{p.pid} {p.status()} {p.cmdline()[:4]}" for p in self.processes()]

    def said(self) -> str:
        return self._log.read_text(encoding="utf-8", errors="replace") if self._log.exists() else ""


def _hear_all() -> None:
    """Have a run hear what this process may ignore: a shell has what it starts in the background ignore SIGINT."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


# Faults of a run at work: each is given the run and a source of chance.


def _send(number: int) -> Callable[[Run, Rng], None]:
    def fault(run: Run, rng: Rng) -> None:
        while len(run.processes()) == 1 and run.process.poll() is None:
            time.sleep(0.01)  # Python itself answers until it has come to our first line
        run.process.send_signal(number)

    fault.__name__ = signal.Signals(number).name.lower()
    return fault


def kill_a_worker(run: Run, rng: Rng) -> None:
    with contextlib.suppress(psutil.NoSuchProcess, IndexError):
        rng.choice(run.processes()[1:]).kill()


def kill_all(run: Run, rng: Rng) -> None:
    for process in run.processes():
        with contextlib.suppress(psutil.NoSuchProcess):
            process.kill()


def halt_a_worker(run: Run, rng: Rng) -> None:
    """A pipe that is slow: one process stands still for a while, the main one as likely as others."""
    with contextlib.suppress(psutil.NoSuchProcess, IndexError):
        chosen = rng.choice(run.processes())
        chosen.suspend()
        time.sleep(rng.uniform(0.1, 2))
        chosen.resume()


def fill_the_disk(run: Run, rng: Rng) -> None:
    """From now on no file can grow beyond a size: a full disk, as a limit of the operating system."""
    for process in run.processes():
        with contextlib.suppress(psutil.NoSuchProcess):
            process.rlimit(psutil.RLIMIT_FSIZE, (rng.choice([0, 5000, 100_000]), -1))


# Faults of a folder that nobody works in.


def _parts(run: Run) -> list[Path]:
    return sorted(p for p in (run.root / "parts").glob("0*.parquet") if p.is_file())


def damage_a_part(run: Run, rng: Rng) -> None:
    for part in rng.sample(_parts(run), min(1, len(_parts(run)))):
        data = bytearray(part.read_bytes())
        if data:
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        part.write_bytes(rng.choice([bytes(data), bytes(data[: len(data) // 2]), b""]))


def swap_two_parts(run: Run, rng: Rng) -> None:
    if len(_parts(run)) > 1:
        one, two = rng.sample(_parts(run), 2)
        content = one.read_bytes()
        one.write_bytes(two.read_bytes())
        two.write_bytes(content)


def remove_a_part(run: Run, rng: Rng) -> None:
    for part in rng.sample(_parts(run), min(1, len(_parts(run)))):
        part.unlink()


def damage_a_table(run: Run, rng: Rng) -> None:
    path = run.root / rng.choice(TABLES)
    if path.exists():
        path.write_bytes(path.read_bytes()[: rng.randrange(1, 1000)])


def damage_the_manifest(run: Run, rng: Rng) -> None:
    path = run.root / "manifest.json"
    if path.exists():
        text = path.read_bytes()
        path.write_bytes(rng.choice([b"", b"{}", b"[1]", b"\xff\xfe", text[: len(text) // 2]]))


def move_the_clock(run: Run, rng: Rng) -> None:
    """The sign of life of a run on another machine, from a clock that is days ahead or behind."""
    owner = run.root / ".owner.json"
    if run.root.is_dir():
        owner.write_text('{"host": "elsewhere", "pid": 4711, "since": "2020-01-01T00:00:00+00:00"}')
        stamp = time.time() + rng.choice([-1, 1]) * rng.uniform(200, 1e6)
        os.utime(owner, (stamp, stamp))
        run.clock_moved = True


def leave_half_a_file(run: Run, rng: Rng) -> None:
    if (run.root / "parts").is_dir():
        name = (
            f"{rng.randrange(CELLS // CHUNK):06d}-{rng.randbytes(16).hex()}-{rng.randbytes(32).hex()}.parquet"
        )
        (run.root / "parts" / name).write_bytes(rng.randbytes(100))


AT_WORK = (
    *(_send(n) for n in (signal.SIGKILL, signal.SIGINT, signal.SIGTERM, signal.SIGHUP)),
    kill_a_worker, kill_all, halt_a_worker, fill_the_disk,
)  # fmt: skip
AT_REST = (
    damage_a_part, swap_two_parts, remove_a_part, damage_a_table, damage_the_manifest, move_the_clock,
    leave_half_a_file,
)  # fmt: skip


def tables(root: Path) -> dict[str, bytes]:
    """Bytes of every table of a run."""
    return {name: (root / name).read_bytes() for name in TABLES}


def session(run: Run, fault: Callable[[Run, Rng], None] | None, instant: float, rng: Rng) -> list[str]:
    """Start or resume a run, do something to it at an instant, wait for its end; what is wrong afterwards."""
    run.start()
    problems = []
    with contextlib.suppress(subprocess.TimeoutExpired):
        run.process.wait(instant if fault is not None else LONGEST / 2)
    problems += [f"listens on {address}" for address in run.listening()]
    if fault is not None and run.process.poll() is None:
        fault(run, rng)
    try:
        run.process.wait(LONGEST)
    except subprocess.TimeoutExpired:
        kill_all(run, rng)
        problems.append(f"did not end within {LONGEST:.0f} s")
    return problems + [f"left behind {orphan}" for orphan in run.orphans()]


def chaos(
    work: Path, faults: int, seed: int, say: Callable[[str], None] = print
) -> tuple[Counter[str], list[str]]:
    """Draw faults, some for each of several runs.

    Returns
    -------
    drawn : Counter
        How often each fault was drawn.
    problems : list of str
        What did not hold; empty.
    """
    site, config, rng = work / "site", work / "chaos.toml", random.Random(seed)
    install(site, "hostile", {"hostile": "hostile:Hostile"}, hostile=HOSTILE)
    config.write_text(CONFIG, encoding="utf-8")
    path = os.pathsep.join([str(site), str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    env = {**os.environ, "PYTHONPATH": path}
    undisturbed = Run(config, work / "whole", env)
    start = time.monotonic()
    problems = session(undisturbed, None, 0.0, rng)
    length, whole = time.monotonic() - start, tables(work / "whole")
    rows = pq.read_table(work / "whole/cells.parquet", columns=["cell", "solver", "status"]).to_pylist()
    problems += [] if len(rows) == 3 * CELLS else [f"{len(rows)} rows"]
    crashed = sum(row["status"] == "crashed" for row in rows if row["solver"] == "hostile")
    say(f"undisturbed: {length:.0f} s, {crashed} cells crash the hostile solver")
    drawn: Counter[str] = Counter()
    while drawn.total() < faults:
        run = Run(config, work / f"run{drawn.total():03d}", env)
        history = []
        for _ in range(min(FAULTS, faults - drawn.total())):
            at_rest = run.root.is_dir() and rng.random() < 0.5
            fault = rng.choice(AT_REST if at_rest else AT_WORK)
            instant = rng.uniform(0, length)
            history.append(fault.__name__ + ("" if at_rest else f" at {instant:.1f} s"))
            drawn[fault.__name__] += 1
            if at_rest:
                fault(run, rng)
            else:
                problems += [f"{run.root.name}: {each}" for each in session(run, fault, instant, rng)]
        problems += [f"{run.root.name}: {each}" for each in session(run, None, 0.0, rng)]
        found = []
        if run.process.returncode != 0:
            found.append(f"exit code {run.process.returncode}: {run.said()[-300:]}")
        else:
            found += [f"{name} differs" for name, data in tables(run.root).items() if data != whole[name]]
            found += [f"{path.name} is left" for path in run.root.rglob(".tmp-*")]
        found += (
            [f"a traceback: {run.said()[at:][:3000]}"] if (at := run.said().find("Traceback")) >= 0 else []
        )
        problems += [f"{run.root.name} after {', '.join(history)}: {each}" for each in found]
        say(f"{run.root.name}: {', '.join(history)}: {'; '.join(found) or 'the same tables'}")
    return drawn, problems


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--faults", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="folder of the runs; by default it is removed at the end")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        counts, wrong = chaos(asked.keep or Path(temporary), asked.faults, asked.seed)
    print(f"{counts.total()} faults {dict(counts)}: {len(wrong)} problems")
    print("\n".join(wrong))
    sys.exit(bool(wrong))
