"""The only module of the golden values that uses names of the project: plain values in, plain values out.

A collision is a dictionary, as `inputs/*.jsonl` hold it. All numbers are in SI units, ball 1 comes first, and up is
positive. The keys are:

* masses, velocities: one per ball
* stiffnesses, restitutions, gaps (empty: all contacts closed): one per contact
* table: whether the last contact is with a table
* exponent: of the contact force
* gravity: 0, or g of a drop on a lower ball that has settled
* cutoff: "exact", a number or "inf"
* kernel: "pair" for two balls on a table by the solver made for them, "chain" for N balls

States are sets of active contacts, such as "1+2 2 -", for two balls and for N.
"""

import hashlib
import math

import numpy as np
import pyarrow.parquet as pq
from scipy.interpolate import PchipInterpolator

from impact_xval.compliant_baselines import get_solver, references
from impact_xval.compliant_baselines.solver import Convergence, Settings
from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.hypothesis.config import HypothesisConfig
from impact_xval.experiments.hypothesis.run import judge_runs, prepare_runs
from impact_xval.experiments.measures.summary import summarise
from impact_xval.experiments.sweep.run import run_sweep
from impact_xval.model import Collision, Collisions

_OF_N = ("state-transition", "liu-zhao-brogliato", "bistiffness", "kelvin-voigt", "kelvin-voigt-textbook")
# laws in time with frozen positions, which the ladder uses
_FROZEN = ("bistiffness-frozen", "kelvin-voigt-frozen")
#: Exact solvers by kernel.
EXACT = {
    "pair": (*_OF_N, "kelvin-voigt-anchored", "hunt-crossley", *_FROZEN),
    "chain": (*_OF_N, "hunt-crossley", *_FROZEN),
}
ENGINES = ("mujoco", "pybullet")

_STATES = {"S1": "1+2", "S2": "2", "S3": "1", "S4": "-"}
_LONGEST = 40  # largest number of states that are written out
_FRACTIONS = np.linspace(0, 1, 11)


def solve(problem, solver, *, path=False):
    """Return the outcome of a collision by a solver, in plain values; with its sampled path if `path` is true."""
    names = ("masses", "stiffnesses", "restitutions", "velocities", "table", "gaps", "exponent")
    given = (problem[name] for name in names)
    collision = Collision(*(tuple(map(float, x)) if isinstance(x, list) else x for x in given))
    if solver not in _FROZEN:
        outcome = get_solver(solver).solve_many([collision], _settings(problem, path))[0]
    elif any(problem["gaps"]):
        return {"status": "unrepresentable"}  # this solver would raise an exception
    else:
        how = {"frozen": True, "gravity": problem["gravity"], "paths": path}
        (outcome,) = references.solve_by_law(
            Collisions.of([collision]), solver.removesuffix("-frozen"), **how
        )
    if not np.isfinite(outcome.velocities).all():
        return {"status": outcome.status}
    states = [_STATES.get(state, state) for state in outcome.states]
    numbers = {k: plain(v) for k, v in outcome.diagnostics.items() if solver in ENGINES or k != "n_steps"}
    found = {
        "status": outcome.status,
        "velocities": [*map(float, outcome.velocities)],
        "impulses": [*map(float, outcome.impulses)],
        "states": _written(states),
        "events": int(outcome.n_events),
        "margin": plain(outcome.grazing_margin),
        "mark": "+".join(word for word in ("grazing", "cut-off") if word in outcome.mark)
        or ("jump" if outcome.marked else ""),
        "diagnostics": numbers,
    }
    # golden values hold only the last states and the duration
    if solver in _FROZEN and problem["kernel"] == "pair":
        found |= {"states": f"{_written(states[-32:])} of {len(states)}", "margin": None, "mark": ""}
        found["diagnostics"] = {"duration": numbers["duration"]}
    return found | {"path": _sampled(outcome.path)} if path else found


def _settings(problem, path):
    g, cutoff = problem["gravity"], problem["cutoff"]
    return Settings(
        scenario="drop" if g else "impact",
        gravity=g or 9.81,
        stiffness_ratio_cutoff=cutoff if cutoff == "exact" else float(cutoff),
        record_path=path,
        convergence=Convergence(),
    )


def _written(states):
    """Write a sequence of states as text; a long sequence by its first states, their number and a digest of all."""
    text = " ".join(states)
    if len(states) <= _LONGEST:
        return text
    digest = hashlib.sha256(text.encode()).hexdigest()[:12]
    return f"{' '.join(states[:_LONGEST])} ... {len(states)} states, sha256 {digest}"


def plain(value):
    """Return a value as JSON can hold it: infinity and NaN, which strict JSON has no numbers for, as text."""
    if value is None or isinstance(value, str):
        return value
    number = value.item() if isinstance(value, np.generic) else value
    return number if math.isfinite(number) else repr(float(number))


def _sampled(path):
    """Return samples of a path that do not depend on how many points its solver recorded.

    The samples are the rows at both ends, the first row of each state (at most as many as states are written out), and
    impulses interpolated at eleven fractions of the duration.
    """
    time, impulses = path.time, path.impulses
    first = np.append(True, (path.active[1:] != path.active[:-1]).any(axis=1))
    rows = [*np.flatnonzero(first)[:_LONGEST], len(time) - 1]
    at, places = np.unique(time, return_index=True)
    between = PchipInterpolator(at, impulses[places])(_FRACTIONS * at[-1])
    return {
        "time": time[rows].tolist(),
        "velocities": path.velocities[rows].tolist(),
        "impulses": impulses[rows].tolist(),
        "interpolated": between.tolist(),
    }


def tables(spec, folder):
    """Run an experiment and return its tables by name, each as columns of plain values."""
    spec = dict(spec)
    config = {name: spec.pop(name) for name in ("solvers", "step_fraction", "m1", "k1", "v0")}
    if "cells" in spec:
        rows = [",".join(repr(float(x)) for x in cell) for cell in spec["cells"]]
        (folder / "cells.csv").write_text("\n".join(["stiffness_ratio,mass_ratio,e1,e2", *rows]))
        config |= {"cells": str(folder / "cells.csv"), "scenario": "drop", "gravity": spec["gravity"]}
    else:
        config |= {"chain": spec}
    run = run_sweep(
        parse_config(config | {"chunk_size": 10}), folder / "run", workers=1, isolate=False
    ).folder
    names = ("cells", "divergence", "ladder")
    found = {name: _columns(pq.read_table(run.root / f"{name}.parquet").to_pydict()) for name in names}
    summary = summarise(run)
    # Statistics of a single row only repeat the divergence table.
    statistics = summary.statistics[summary.statistics.n > 1]
    more = {"summary": statistics, "statuses": summary.statuses.reset_index()}
    return found | {name: _columns(frame.to_dict("list")) for name, frame in more.items()}


def hypothesis(spec, folder):
    """Test the hypothesis by the exact solvers, and return the tables that `spec` names, each as columns of text."""
    config = HypothesisConfig(**{name: value for name, value in spec.items() if name != "tables"})
    for _, solve in prepare_runs(config, folder):
        solve(workers=1, isolate=False)
    found = judge_runs(config, folder)
    frames = {"limits": found.verdicts, "points": found.points, "chains": found.chains}
    return {name: _columns(frames[name].to_dict("list")) for name in spec["tables"]}


def _columns(data):
    return {str(name): [_field(value) for value in values] for name, values in data.items()}


def _field(value):
    """Return a value as text, as a CSV file holds it, with all digits of a number."""
    if value is None:
        return ""
    value = value.item() if isinstance(value, np.generic) else value
    return repr(float(value)) if isinstance(value, (int, float)) else str(value)


def unavailable(engine):
    return get_solver(engine).unavailable()
