"""Legal extremes drawn at random: ``python -m tests.experiments.extremes --configurations 300 --calls 300 --seed 1``.

Configurations at the ends of what is legal are run by the command, and commands are called with options at the ends of
theirs. Whatever is drawn is legal, so each must end as a legal input does, without a traceback or a warning, leave no
process behind, and say something at least once a minute.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import random
import re
import shlex
import subprocess
import sys
import tempfile
import threading
import time
import uuid
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from impact_xval.experiments.config.configuration import load_config
from impact_xval.experiments.config.errors import UserError
from tests.experiments.chaos import marked

ROOT = Path(__file__).parents[2]
MARK = "IMPACT_XVAL_EXTREMES"

#: Seconds without a line, seconds in which what a command started must be gone after it, and in which it must end.
SILENCE, GONE, LONGEST = 60.0, 10.0, 900.0

#: How a line of progress ends.
PROGRESS = re.compile(r"( \.\.\.| has taken \d+ s)$")

Rng = random.Random

RATIOS = (
    1e-300,
    1e-150,
    1e-30,
    1e-12,
    1e-5,
    0.1,
    0.5,
    1.0,
    1 + 1e-15,
    2.937,
    23.0,
    1e5,
    1e12,
    1e30,
    1e150,
    1e300,
)
RESTITUTIONS = (0.0, 1e-300, 1e-17, 1e-5, 0.5, 0.9, 1 - 1e-16, 1.0)
FREE = ("bistiffness", "kelvin-voigt", "kelvin-voigt-anchored", "kelvin-voigt-textbook", "hunt-crossley")
ENGINES = ("mujoco", "pybullet", "drake")


@dataclass(frozen=True)
class Ended:
    """How a command ended.

    Attributes
    ----------
    code : int
    said : str
        On standard output and standard error.
    silence : float
        Longest time without a line, in s.
    left : list of str
        Processes it left behind.
    """

    code: int
    said: str
    silence: float
    left: list[str]

    def problems(self, legal: tuple[int, ...]) -> list[str]:
        """What is wrong, where these exit codes are legal."""
        found = [] if self.code in legal else [f"exit code {self.code}"]
        found += [
            f"says {word}" for word in ("Traceback", "Warning", "Exception ignored") if word in self.said
        ]
        found += [f"no line for {self.silence:.0f} s"] if self.silence > SILENCE else []
        if (
            self.code == 2
            and len([line for line in self.said.splitlines() if not PROGRESS.search(line)]) != 1
        ):
            found.append("more than one line of an error")
        return found + [f"leaves {process}" for process in self.left]


def call(words: list[str], work: Path) -> Ended:
    """Call the command and watch it."""
    mark = uuid.uuid4().hex
    with subprocess.Popen(
        [sys.executable, "-m", "impact_xval", *words],
        cwd=work,
        env={**os.environ, MARK: mark, "PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        stdin=subprocess.DEVNULL,
    ) as process:
        watchdog = threading.Timer(LONGEST, process.terminate)
        watchdog.start()
        lines, silence, last = [], 0.0, time.monotonic()
        for line in iter(process.stdout.readline, b""):
            silence, last = max(silence, time.monotonic() - last), time.monotonic()
            lines.append(line.decode(errors="replace"))
        code = process.wait()
        watchdog.cancel()
    return Ended(code, "".join(lines), max(silence, time.monotonic() - last), _left(mark))


def _left(mark: str) -> list[str]:
    """Processes of a command that are there `GONE` seconds after its end."""
    until = time.monotonic() + GONE
    while (found := marked(MARK, mark)) and time.monotonic() < until:
        time.sleep(0.05)
    return list(map(str, found))


# Configurations.


def _some(rng: Rng, values: tuple[Any, ...], most: int) -> list[Any]:
    return rng.sample(values, rng.randint(1, min(most, len(values))))


def _ratio(rng: Rng) -> float:
    return rng.choice(RATIOS) if rng.random() < 0.6 else 10.0 ** rng.uniform(-300, 300)


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {_toml(each)}" for key, each in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    if isinstance(value, float) and math.isinf(value):
        return "inf"
    return json.dumps(value)


def _ranges(rng: Rng) -> dict[str, Any]:
    def log(values: tuple[float, ...]) -> Any:
        low, high = sorted(rng.sample(values, 2))
        return {"log": [low, high]} if rng.random() < 0.7 else low

    def linear() -> Any:
        low, high = sorted(rng.sample(RESTITUTIONS, 2))
        return {"linear": [low, high]} if rng.random() < 0.7 else low

    return {"stiffness_ratio": log(RATIOS), "mass_ratio": log(RATIOS), "e1": linear(), "e2": linear()}


def _design(rng: Rng) -> dict[str, Any]:
    """One to six cells."""
    if rng.random() < 0.3:
        method = rng.choice(["sobol", "latin-hypercube"])
        return {
            "sample": {"method": method, "n": rng.choice([1, 2, 4]), "seed": rng.randrange(9), **_ranges(rng)}
        }
    axes = dict.fromkeys(("stiffness_ratio", "mass_ratio", "e1", "e2"), 1)
    axes[rng.choice(list(axes))] = rng.randint(1, 3)
    axes[rng.choice(list(axes))] = 2
    ratios = (*RATIOS, 0.0, math.inf)
    kinds = {"stiffness_ratio": ratios, "mass_ratio": RATIOS, "e1": RESTITUTIONS, "e2": RESTITUTIONS}
    return {"grid": {name: rng.sample(kinds[name], n) for name, n in axes.items()}}


def configuration(rng: Rng) -> dict[str, Any]:
    """Draw a configuration; most are legal."""
    solvers = _some(rng, FREE, 3) if rng.random() < 0.85 else []
    solvers += _some(rng, ENGINES, 2) if not solvers or rng.random() < 0.25 else []
    drawn: dict[str, Any] = {
        "name": rng.choice(["x", "\u00fc" * 100, "-", "../a b", "%s {0} $HOME"]),
        "scenario": rng.choice(["impact", "drop"]),
        "solvers": solvers,
        "max_steps": rng.choice([1, 1000, 100_000, 2_000_000]),
        "cell_timeout": rng.choice([0.5, 5]),
    }
    optional = {
        "gravity": (5e-324, 1e-300, 1e-30, 1e-3, 1e3, 1e30, 1e300),
        "m1": (1e-300, 1e-30, 1e-6, 1e6, 1e30, 1e300),
        "k1": (5e-324, 1e-300, 1e-10, 1.0, 1e15, 1e300),
        "v0": (-5e-324, -1e-300, -1e-9, -1e3, -1e100, -1e300),
        "step_fraction": (5e-324, 1e-17, 1e-4, 0.1),
        "shortest_state": (0, 1e-300, 0.1),
        "mapping": ("naive",),
        "stiffness_ratio_cutoff": (1.0, 1 + 1e-15, 1e5, 1e300, math.inf),
        "grazing_threshold": (0, 1e-300, 1),
        "chunk_size": (1, 100_000),
        "workers": (1, 2),
        "convergence": (
            {"enabled": False},
            {"halvings": 0},
            {"halvings": 10},
            {"tolerance": 5e-324},
            {"tolerance": 1},
        ),
    }
    drawn |= {key: rng.choice(optional[key]) for key in optional if rng.random() < 0.2}
    if rng.random() < 0.5:
        drawn["figure_cell"] = {
            "stiffness_ratio": _ratio(rng), "mass_ratio": _ratio(rng),
            "e1": rng.choice(RESTITUTIONS), "e2": rng.choice(RESTITUTIONS),
        }  # fmt: skip
    return drawn | _design(rng)


def legal_configuration(rng: Rng, path: Path, draw: Callable[[Rng], dict[str, Any]] = configuration) -> str:
    """Write a legal configuration to a file; its text."""
    while True:
        text = "".join(f"{key} = {_toml(value)}\n" for key, value in draw(rng).items())
        path.write_text(text, encoding="utf-8")
        with contextlib.suppress(UserError):
            load_config(path)
            return text


# Calls.


def _options(rng: Rng, kinds: dict[str, tuple[Any, ...]], share: float) -> list[str]:
    return [
        word
        for key, values in kinds.items()
        if rng.random() < share
        for word in (key, str(rng.choice(values)))
    ]


_SCALES: dict[str, tuple[Any, ...]] = {
    "--scenario": ("impact", "drop"),
    "--gravity": (1e-300, 1e-3, 1e3, 1e300),
    "--m1": (1e-300, 1e-6, 1e6, 1e300),
    "--k1": (1e-300, 1.0, 1e15, 1e300),
    "--v0": (-1e-300, -1e-9, -1e3, -1e300),
}


def _cell(rng: Rng) -> list[str]:
    e1, e2 = (str(rng.choice(RESTITUTIONS)) for _ in range(2))
    return ["--stiffness-ratio", str(_ratio(rng)), "--mass-ratio", str(_ratio(rng)), "--e1", e1, "--e2", e2]


def _solve(rng: Rng, folders: list[Path], out: Path) -> list[str]:
    names = _some(rng, (*FREE, "state-transition", *(ENGINES if rng.random() < 0.4 else ())), 3)
    words = ["solve", *_cell(rng), *(word for name in names for word in ("--solver", name))]
    words += _options(
        rng, _SCALES | {"--step-fraction": (1e-12, 0.1), "--cutoff": (1, 1e5, "inf", "exact")}, 0.2
    )
    return [*words, "--cell-timeout", "5", *_options(rng, {"--mapping": ("naive",)}, 0.2)]


def _contact(rng: Rng, folders: list[Path], out: Path) -> list[str]:
    masses = [str(rng.choice([1e-15, 1e-6, 1.0, 3.0, 1e6, 1e15])), str(rng.choice([1e-15, 1.0, 1e15, "inf"]))]
    words = ["contact", "--engine", rng.choice(ENGINES[:2]), "--masses", *masses]
    words += ["--restitution", str(rng.choice([1e-4, 0.01, 0.5, 0.99, 1]))]
    words += rng.choice(
        [["--stiffness", str(10.0 ** rng.uniform(-12, 18))], ["--duration", str(10.0 ** rng.uniform(-9, 6))]]
    )
    return words + _options(
        rng, {"--speed": (1e-9, 1e-3, 1e9), "--gravity": (0, 1e-3, 1e3), "--tolerance": (1e-6, 0.5)}, 0.3
    )


def _map(rng: Rng, folders: list[Path], out: Path) -> list[str]:
    words = ["map", "--e1", str(rng.choice(RESTITUTIONS[2:])), "--e2", str(rng.choice(RESTITUTIONS[2:]))]
    for name in ("--stiffness-ratio", "--mass-ratio"):
        low, high = sorted(rng.sample((1e-12, 1e-6, 1e-3, 1.0, 1e3, 1e6, 1e12), 2))
        words += [name, str(low), str(high)]
    return [*words, "--side", str(rng.randint(2, 4)), "--out", str(out), *_options(rng, _SCALES, 0.2)]


def _export(rng: Rng, folders: list[Path], out: Path) -> list[str]:
    words = ["export-scene", *_cell(rng), "--out", str(out), *_options(rng, _SCALES, 0.2)]
    return [*words, "--solver", rng.choice(ENGINES[:2])]


def _of_a_folder(name: str) -> Callable[[Rng, list[Path], Path], list[str]]:
    def draw(rng: Rng, folders: list[Path], out: Path) -> list[str]:
        words = [name, str(rng.choice(folders))]
        if name == "ladder":
            words += _options(rng, {"--law": ("hunt-crossley", "kelvin-voigt-textbook"), "--cell": (0,)}, 0.4)
        return words + (["--json"] if name in ("status", "doctor") and rng.random() < 0.5 else [])

    return draw


def _hypothesis(rng: Rng, folders: list[Path], out: Path) -> list[str]:
    config = out.with_suffix(".toml")
    contrast = sorted(rng.sample((1 + 1e-9, 10.0, 1e3, 1e6, 1e10), 2))
    drawn = {
        "points": 6,
        "seed": rng.choice([0, 2**32]),
        "solvers": _some(rng, FREE[:3], 2),
        "contrast": contrast,
        "plastic_contrast": [contrast[0], rng.choice([1e12, 1e16])],
        "per_decade": 4,
        "fit_decades": rng.choice([1.0, 8.0]),
        "cell_timeout": 5,
        "map": {"size": 4, "engine_size": 3, "mass_ratio": sorted(rng.sample((1e-300, 1e-3, 1.0, 1e12), 2))},
    }
    config.write_text("".join(f"{key} = {_toml(value)}\n" for key, value in drawn.items()), encoding="utf-8")
    return ["hypothesis", str(config), "--out", str(out)]


def _calibrate(rng: Rng, folders: list[Path], out: Path) -> list[str]:
    return ["calibrate", "--engine", rng.choice(ENGINES[:2]), "--out", str(out)]


#: How a call is drawn, how often, and which exit codes are legal beside 0: 2 where what is legal by itself is not
#: together, in one line, and 1 for what a command found.
CALLS: dict[str, tuple[Callable[[Rng, list[Path], Path], list[str]], int, tuple[int, ...]]] = {
    "solve": (_solve, 100, (2,)),
    "contact": (_contact, 45, (1, 2)),
    "map": (_map, 30, (2,)),
    "export-scene": (_export, 20, (1, 2)),
    "ladder": (_of_a_folder("ladder"), 30, (2,)),
    **{name: (_of_a_folder(name), 15, ()) for name in ("table", "figures", "report", "status")},
    "doctor": (_of_a_folder("doctor"), 10, (1,)),
    "hypothesis": (_hypothesis, 4, ()),
    "calibrate": (_calibrate, 1, ()),
}


def extremes(
    work: Path, configurations: int, calls: int, seed: int, say: Callable[[str], None] = print, first: int = 0
) -> tuple[Counter[str], list[str]]:
    """Draw configurations, run them, and call commands; those of a folder get one of these runs.

    What has one number and seed is the same whatever is drawn before: from `first` on, numbers go on.

    Returns
    -------
    counts : Counter
        Commands by how they ended.
    problems : list of str
        What did not hold; empty.
    """
    counts: Counter[str] = Counter()
    problems: list[str] = []

    def one(label: str, words: list[str], legal: tuple[int, ...], text: str = "") -> int:
        start = time.monotonic()
        ended = call(words, work)
        found = ended.problems(legal)
        counts[f"{words[0]}: {ended.code}"] += 1
        problems.extend(f"{label}: {shlex.join(words)}: {each}\n{text}{ended.said[-3000:]}" for each in found)
        say(f"{label}: {words[0]} {ended.code} {time.monotonic() - start:.0f} s {'; '.join(found) or 'ok'}")
        return ended.code

    folders = []
    for number in range(first, first + configurations):
        rng, path = random.Random(f"{seed} configuration {number}"), work / f"c{number:03d}.toml"
        text = legal_configuration(rng, path)
        if one(path.stem, ["run", str(path), "--out", str(work / path.stem)], (0,), text) == 0:
            folders.append(work / path.stem)
    names, shares = list(CALLS), [share for _, share, _ in CALLS.values()]
    for number in range(first, first + calls):
        rng = random.Random(f"{seed} call {number}")
        draw, _, legal = CALLS[rng.choices(names, shares)[0]]
        one(f"call {number}", draw(rng, folders, work / f"o{number:03d}"), (0, *legal))
    return counts, problems


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--configurations", type=int, default=300)
    parser.add_argument("--calls", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="number of the first configuration and call")
    parser.add_argument("--keep", type=Path, help="folder of the runs; by default it is removed at the end")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        counts, wrong = extremes(
            asked.keep or Path(temporary), asked.configurations, asked.calls, asked.seed,
            lambda line: print(line, flush=True), asked.first,
        )  # fmt: skip
    print(f"{counts.total()} commands {dict(sorted(counts.items()))}: {len(wrong)} problems")
    print("\n".join(wrong))
    sys.exit(bool(wrong))
