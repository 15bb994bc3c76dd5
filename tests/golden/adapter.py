"""The one module of the golden values that knows the names of the project: plain values in, plain values out.

A collision is a dictionary as `inputs/*.jsonl` hold it, all numbers in SI units, ball 1 first, up positive:

* masses, velocities, one a ball; stiffnesses, restitutions, gaps (none: closed), one a contact; table; exponent;
* gravity: 0, or g of a drop on a lower ball that has settled; cutoff: "exact", a number or "inf";
* kernel: "pair" for two balls on a table by the solver made for them, "chain" for N balls.

States are sets of acting contacts, "1+2 2 -", for two balls and for N.
"""

import hashlib
import json
import math
import platform
from importlib.metadata import version

import llvmlite.binding
import numba
import numpy as np
import pyarrow.parquet as pq
from scipy.interpolate import PchipInterpolator

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.contract.solver import Convergence, Settings
from impact_xval.compliant_baselines.references.bistiffness import bistiffness_batch
from impact_xval.compliant_baselines.references.columns.solving import solve_column
from impact_xval.compliant_baselines.references.kelvin_voigt import kelvin_voigt_batch
from impact_xval.experiments.config.configuration import parse_config
from impact_xval.experiments.hypothesis.config import parse as parse_hypothesis
from impact_xval.experiments.hypothesis.run import run_hypothesis
from impact_xval.experiments.hypothesis.tables import (
    class_frame,
    column_class_frame,
    need_frame,
    point_frame,
)
from impact_xval.experiments.measures.columns.summary import summarise_columns
from impact_xval.experiments.measures.summary import summarise
from impact_xval.experiments.sweep.run import run_sweep
from impact_xval.model import Collision, Column

_OF_N = ("state-transition", "liu-zhao-brogliato", "bistiffness", "kelvin-voigt", "kelvin-voigt-textbook")
_FROZEN = ("bistiffness-frozen", "kelvin-voigt-frozen")  # the corners of the ladder
#: The exact solvers by kernel; the oracle is a test of the model, not a solver of its own.
EXACT = {
    "pair": (*_OF_N, "kelvin-voigt-anchored", "hunt-crossley", *_FROZEN),
    "chain": (*_OF_N, "hunt-crossley", *_FROZEN),
}
ENGINES = ("mujoco", "pybullet")

#: Columns of the tables by their name in the golden values: what they are called now, or None where they were dropped.
COLUMNS = dict.fromkeys(("verdict_redrawn", "share_supported_redrawn", "share_refuted_redrawn"))

_STATES = {"S1": "1+2", "S2": "2", "S3": "1", "S4": "-"}
_LONGEST = 40  # states that are written out
_FRACTIONS = np.linspace(0, 1, 11)
_BATCHES = {"bistiffness-frozen": bistiffness_batch, "kelvin-voigt-frozen": kelvin_voigt_batch}


def solve(problem, solver, *, path=False):
    """Outcome of a collision by a solver, in plain values; with its path in `path`, if asked for."""
    frozen = solver in _FROZEN
    if problem["kernel"] == "pair":
        m1, m2 = problem["masses"]
        k1, k2 = map(float, problem["stiffnesses"])
        v0, still = problem["velocities"]
        assert still == 0
        collision = Collision(m1, m2, k1, k2, *problem["restitutions"], v0)
        if frozen:
            return _frozen_pair(collision, problem["gravity"], solver)
        outcome = get_solver(solver).solve_many([collision], _settings(problem, path))[0]
        velocities, impulses = (outcome.v1, outcome.v2), (outcome.impulse1, outcome.impulse2)
        states = [_STATES[state] for state in outcome.states]
    else:
        names = ("masses", "stiffnesses", "restitutions", "velocities", "table", "gaps")
        column = Column(*(problem[name] for name in names))
        settings = _settings(problem, path)
        if frozen and any(problem["gaps"]):
            return {"status": "unrepresentable"}  # it raises
        if frozen:
            law = solver.removesuffix("-frozen")
            outcome = solve_column(column, law, exponent=problem["exponent"], frozen=True)
        else:
            outcome = get_solver(solver).solve_columns([column], settings, problem["exponent"])[0]
        velocities, impulses = outcome.velocities, outcome.impulses
        states = ["+".join(map(str, contacts)) or "-" for contacts in outcome.states]
    if not np.isfinite(velocities).all():
        return {"status": outcome.status}
    numbers = {k: plain(v) for k, v in outcome.diagnostics.items() if solver in ENGINES or k != "n_steps"}
    found = {
        "status": outcome.status,
        "velocities": [float(v) for v in velocities],
        "impulses": [float(i) for i in impulses],
        "states": _written(states),
        "events": int(outcome.n_events),
        "margin": plain(outcome.grazing_margin),
        "mark": "+".join(word for word in ("grazing", "cut-off") if word in outcome.marked)
        or ("jump" if outcome.marked else ""),
        "diagnostics": numbers,
    }
    return (
        found | {"path": (_curve if problem["kernel"] == "pair" else _trail)(outcome.path)} if path else found
    )


def _settings(problem, path):
    g, cutoff = problem["gravity"], problem["cutoff"]
    return Settings(
        scenario="drop" if g else "impact",
        gravity=g or 9.81,
        stiffness_ratio_cutoff=cutoff if cutoff == "exact" else float(cutoff),
        record_path=path,
        convergence=Convergence(),
    )


def _frozen_pair(collision, gravity, solver):
    c, unit = collision, collision.units
    number = c.gravity_number(gravity) if 0 < c.k1 < math.inf else 0.0
    found = _BATCHES[solver](c.stiffness_ratio, c.mass_ratio, c.e1, c.e2, number, frozen=True)
    if not np.isfinite(found.v1):
        return {"status": str(found.status)}
    states = [_STATES[state] for state in found.states(())]  # the last 32 of them
    return {
        "status": str(found.status),
        "velocities": [float(v) * unit.velocity for v in (found.v1, found.v2)],
        "impulses": [float(i) * unit.impulse for i in (found.impulse1, found.impulse2)],
        "states": f"{_written(states)} of {found.n_states}",
        "events": int(found.n_events),
        "margin": None,
        "mark": "",
        "diagnostics": {"duration": float(found.duration) * unit.time},
    }


def _written(states):
    """Write a sequence of states; of a long one the first, the number and a digest of all."""
    text = " ".join(states)
    if len(states) <= _LONGEST:
        return text
    digest = hashlib.sha256(text.encode()).hexdigest()[:12]
    return f"{' '.join(states[:_LONGEST])} ... {len(states)} states, sha256 {digest}"


def plain(value):
    """Write infinity and NaN, which strict JSON has no numbers for, as text."""
    if value is None or isinstance(value, str):
        return value
    number = value.item() if isinstance(value, np.generic) else value
    return number if math.isfinite(number) else repr(float(number))


def _curve(path):
    impulses = np.column_stack([path.impulse1, path.impulse2])
    acting = np.array([(True, True), (False, True), (True, False), (False, False)])[path.state - 1]
    return _sampled(path.time, np.column_stack([path.v1, path.v2]), impulses, acting)


def _trail(path):
    return _sampled(path.time, path.velocities, path.impulses, path.acting)


def _sampled(time, velocities, impulses, acting):
    """Sample a path whose rows are its solver's choice.

    Exact: its ends and the first rows of its states, as many as are written out. Interpolated: impulses at eleven
    fractions of its duration.
    """
    first = np.append(True, (acting[1:] != acting[:-1]).any(axis=1))
    rows = [*np.flatnonzero(first)[:_LONGEST], len(time) - 1]
    at, places = np.unique(time, return_index=True)
    between = PchipInterpolator(at, impulses[places])(_FRACTIONS * at[-1])
    return {
        "time": time[rows].tolist(),
        "velocities": velocities[rows].tolist(),
        "impulses": impulses[rows].tolist(),
        "interpolated": between.tolist(),
    }


def tables(spec, folder):
    """Tables of a run, by name: of each its columns and its rows, in plain values."""
    spec = dict(spec)
    config = {name: spec.pop(name) for name in ("solvers", "step_fraction", "m1", "k1", "v0")}
    if "cells" in spec:
        rows = [",".join(repr(float(x)) for x in cell) for cell in spec["cells"]]
        (folder / "cells.csv").write_text("\n".join(["stiffness_ratio,mass_ratio,e1,e2", *rows]))
        config |= {"cells": str(folder / "cells.csv"), "scenario": "drop", "gravity": spec["gravity"]}
    else:
        config |= {"column": spec}
    run = run_sweep(parse_config(config | {"chunk_size": 10}), folder / "run", workers=1, isolate=False)
    found = {name: _columns(pq.read_table(run.root / f"{name}.parquet")) for name in ("cells", "divergence")}
    found["ladder"] = _columns(pq.read_table(run.root / "ladder.parquet"))
    summary = (summarise if "cells" in spec else summarise_columns)(run)
    # Statistics of a single row are in the table of divergence.
    statistics = summary.statistics[summary.statistics.n > 1]
    return found | {"summary": _columns(statistics), "statuses": _columns(summary.statuses.reset_index())}


def hypothesis(spec):
    """Tables of a test of the hypothesis by exact solvers, those that `spec` names."""
    config = {name: value for name, value in spec.items() if name != "tables"}
    results = run_hypothesis(parse_hypothesis(config, "golden"), workers=1, isolate=False)
    frames = {
        "limits": class_frame,
        "points": point_frame,
        "columns": column_class_frame,
        "needs": need_frame,
    }
    return {name: _columns(frame(results)) for name, frame in frames.items() if name in spec["tables"]}


def _columns(table):
    data = table.to_pydict() if hasattr(table, "to_pydict") else table.to_dict("list")
    return {str(name): [_field(value) for value in values] for name, values in data.items()}


def _field(value):
    """Write a value as text, as a CSV file holds it; numbers to their last digit."""
    if value is None:
        return ""
    if isinstance(value, (list, tuple)):
        return json.dumps([plain(x) for x in value])
    value = value.item() if isinstance(value, np.generic) else value
    return repr(float(value)) if isinstance(value, (int, float)) else str(value)


def fingerprint():
    """What the last bits of an engine's outcome may depend on."""
    features = json.dumps(sorted(llvmlite.binding.get_host_cpu_features().items()))
    packages = ("numpy", "numba", "llvmlite", *ENGINES)
    return {
        **{name: version(name) for name in packages},
        "libc": "-".join(platform.libc_ver()),
        "machine": platform.machine(),
        "processor": hashlib.sha256(features.encode()).hexdigest()[:12],
        "compiled_for": numba.config.CPU_NAME or "host",
    }


def unavailable(engine):
    """Why an engine cannot run here, or None."""
    return get_solver(engine).unavailable()
