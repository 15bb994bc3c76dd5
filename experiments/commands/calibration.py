"""What ``impact-xval calibrate`` requests of engines, and the tables, the figure and the page made of the results.

Single contacts, ball on table and ball on ball in free fall, over restitution, stiffness and step, by the calibrated
mapping and by the naive one. An engine runs in a sandbox: a contact that crashes it, or hangs, is a row of its own.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from impact_xval.compliant_baselines import SolverError, get_solver
from impact_xval.compliant_baselines.calibration.calibration import (
    ContactRequest,
    ContactResult,
    contact_limit,
    try_contacts,
)
from impact_xval.compliant_baselines.contract.solver import MappingName
from impact_xval.compliant_baselines.engines.engine import EngineSolver
from impact_xval.experiments.presentation.looks import look
from impact_xval.experiments.presentation.pages import render
from impact_xval.experiments.presentation.style import drawing, save
from impact_xval.experiments.sweep.sandbox import FaultError, Sandbox, in_halves
from impact_xval.experiments.tables.numbers import number
from impact_xval.experiments.tables.store import write_text
from impact_xval.experiments.tables.streams import replacing

#: A pandas DataFrame; its annotations are too wide to check code against.
Frame = Any

RESTITUTIONS = (0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
STIFFNESSES = tuple(float(f"1e{power}") for power in range(2, 9))
STEP_FRACTIONS = tuple(1e-3 / 2**n for n in range(4))
CONTACTS = ("ball-table", "ball-ball")
MAPPINGS: tuple[MappingName, ...] = ("calibrated", "naive")
#: Masses of B1 and B2 in kg; 2/sqrt(3) is that of the paper's example.
M1, M2 = 1.0, 2 / 3**0.5
V0 = -1.0

#: Seconds that an engine may take over a batch of contacts.
_TIMEOUT = 300.0

#: Largest error in restitution and, relative, in duration at which a contact counts as the one asked for.
TOLERANCE = 1e-3

#: Errors are drawn no smaller than this.
_FLOOR = 1e-9

#: What identifies one contact asked for, at whatever step.
CONTACT = ["engine", "mapping", "contact", "e", "k"]

#: Name, unit and meaning of the columns of ``calibration.csv``, a row a contact and step.
COLUMNS = {
    "engine": ("-", "name of the engine"),
    "version": ("-", "its version"),
    "mapping": ("-", "how (k, e) became the engine's parameters"),
    "contact": ("-", "ball-table or ball-ball"),
    "e": ("-", "restitution asked for"),
    "k": ("N/m", "stiffness asked for"),
    "mass": ("kg", "reduced mass of the pair"),
    "step_fraction": ("-", "time step over the period of the undamped contact"),
    "status": ("-", "ok, or why there is no result"),
    "reason": ("-", "one sentence where the status is not ok"),
    "restitution": ("-", "restitution obtained"),
    "duration": ("s", "duration obtained"),
    "duration_asked": ("s", "duration asked for, by the formula of the contact that ends at zero force"),
}


def requests() -> list[ContactRequest]:
    """List the contacts to request; the step varies fastest, from the longest."""
    return [
        ContactRequest(contact, e, k, M1, M2, V0, fraction, mapping)
        for mapping, contact, e, k, fraction in itertools.product(
            MAPPINGS, CONTACTS, RESTITUTIONS, STIFFNESSES, STEP_FRACTIONS
        )
    ]


def prepare(name: str) -> None:
    """Make the process of an engine ready: import it, compile what it needs, run a contact."""
    try_contacts(_solver(name), [ContactRequest("ball-table", 0.5)])


def _try(name: str, requests: Sequence[ContactRequest]) -> list[dict[str, Any]]:
    """Run contacts in the process of an engine; what came of each, as columns."""
    return [_columns(answer) for answer in try_contacts(_solver(name), requests)]


def _solver(name: str) -> EngineSolver:
    solver = get_solver(name)
    assert isinstance(solver, EngineSolver)
    return solver


def _columns(answer: ContactResult | SolverError) -> dict[str, Any]:
    if isinstance(answer, SolverError):
        return {"status": answer.status, "reason": answer.reason}
    return {"status": "ok", "restitution": answer.restitution, "duration": answer.duration}


def rows_of(
    solver: EngineSolver, sandbox: Sandbox, requests: Sequence[ContactRequest]
) -> list[dict[str, Any]]:
    """Run contacts by an engine in its sandbox; a row each, columns `COLUMNS`."""
    reason = solver.unavailable()
    if reason is None:
        results = _isolated(sandbox, requests)
    else:
        results = [{"status": "unavailable", "reason": reason}] * len(requests)
    version = solver.version() if reason is None else ""
    return [
        {
            "engine": solver.name,
            "version": version,
            "mapping": request.mapping,
            "contact": request.contact,
            "e": request.e,
            "k": request.k,
            "mass": request.asked().mass,
            "step_fraction": request.step_fraction,
            "duration_asked": request.asked().duration,
            **result,
        }
        for request, result in zip(requests, results, strict=True)
    ]


def _isolated(sandbox: Sandbox, requests: Sequence[ContactRequest]) -> list[dict[str, Any]]:
    """Run contacts together; where the process dies or hangs, halve them to find the one that is at fault."""

    def run(place: slice) -> list[dict[str, Any]]:
        return sandbox.call(_try, requests[place], timeout=_TIMEOUT)

    def lost(place: slice, fault: FaultError) -> list[dict[str, Any]]:
        return [{"status": fault.status, "reason": str(fault)}]

    return [row for rows in in_halves(run, len(requests), lost) for row in rows]


@dataclass(frozen=True, slots=True)
class Calibration:
    """What came of it.

    Attributes
    ----------
    steps : DataFrame
        A row a contact and step, columns `COLUMNS`.
    limits : DataFrame
        A row a contact: `CONTACT`, then ``restitution_at_step, duration_ratio_at_step`` at the longest step,
        ``restitution, duration_ratio`` in the limit dt -> 0 and ``restitution_order, duration_order, order`` (of
        both errors together); NaN where a step has no result.
    versions : dict
        Version by engine; why not, for one that is unavailable.
    """

    steps: Frame
    limits: Frame
    versions: dict[str, str]

    @classmethod
    def of(cls, rows: Sequence[dict[str, Any]], engines: Sequence[EngineSolver]) -> Calibration:
        """Arrange the rows of all engines, and extrapolate each contact to a step of zero."""
        steps = pd.DataFrame(rows, columns=list(COLUMNS))
        limits = [_limit(key, group) for key, group in steps.groupby(CONTACT, sort=False)]
        versions = {solver.name: solver.unavailable() or solver.version() for solver in engines}
        return cls(steps, pd.DataFrame(limits), versions)

    def errors(self, engine: str, mapping: str) -> Frame:
        """Rows of `limits` of an engine by a mapping, and its errors, in the limit and at the longest step."""
        rows = self.limits[(self.limits.engine == engine) & (self.limits.mapping == mapping)]
        return rows.assign(
            error_e=rows.restitution - rows.e,
            error_t=rows.duration_ratio - 1,
            error_e_at_step=rows.restitution_at_step - rows.e,
            error_t_at_step=rows.duration_ratio_at_step - 1,
        )

    def summary(self) -> dict[str, Any]:
        """Facts of ``calibration_summary.md.j2``: what each engine reproduces, and the worst of each contact."""
        engines, rows = [], []
        for engine, version in self.versions.items():
            good, naive = self.errors(engine, "calibrated"), self.errors(engine, "naive")
            within = (good.error_e.abs() <= TOLERANCE) & (good.error_t.abs() <= TOLERANCE)
            engines.append(
                {
                    "name": engine,
                    "version": version,
                    "missing": None
                    if good.restitution.notna().any()
                    else self.steps[self.steps.engine == engine].reason.iloc[0],
                    "kept": int(within.sum()),
                    "contacts": len(good),
                    "worst": good.filter(like="error").abs().max().to_dict(),
                    "naive": None
                    if naive.restitution_at_step.isna().all()
                    else naive.error_e_at_step.abs().agg(["median", "max"]).to_dict()
                    | {"low": naive.duration_ratio_at_step.min(), "high": naive.duration_ratio_at_step.max()},
                    "naive_failed": int(naive.restitution_at_step.isna().sum()),
                    "naive_contacts": len(naive),
                }
            )
            for contact, at in good.groupby("contact", sort=False):
                done = f"{at.restitution.notna().sum()} of {len(at)}"
                worst = (number(at[name].abs().max(), 2) for name in ("error_e", "error_t"))
                orders = (at.order, at[at.e < 1].restitution_order, at[at.e == 1].restitution_order)
                ranges = map(_range, (*orders, at.duration_order))
                rows.append((engine, str(contact), done, *worst, *ranges))
        return {"engines": engines, "summary": rows, "tolerance": TOLERANCE, "step": STEP_FRACTIONS[0]}

    def limit_rows(self, engine: str) -> list[tuple[str, ...]]:
        """Rows of an engine by contact and e: the worst over k, and the fitted orders."""
        worst = ("error_e_at_step", "error_t_at_step", "error_e", "error_t")
        return [
            (
                str(contact),
                number(e),
                *(_signed(group[name]) for name in worst),
                _range(group.restitution_order),
                _range(group.duration_order),
            )
            for (contact, e), group in self.errors(engine, "calibrated").groupby(["contact", "e"], sort=False)
        ]

    def naive_rows(self) -> list[tuple[str, ...]]:
        """Rows of all engines by contact and e: ranges over k by the calibrated and by the naive mapping."""
        rows = []
        for (engine, contact, e), group in self.limits.groupby(["engine", "contact", "e"], sort=False):
            ranges = (
                _range(group[group.mapping == mapping][name])
                for name in ("restitution_at_step", "duration_ratio_at_step")
                for mapping in MAPPINGS
            )
            rows.append((str(engine), str(contact), number(e), *ranges))
        return rows


def _limit(key: Any, group: Frame) -> dict[str, Any]:
    row: dict[str, Any] = dict(zip(CONTACT, key, strict=True))
    ratio = group.duration / group.duration_asked
    row |= {"restitution_at_step": group.restitution.iloc[0], "duration_ratio_at_step": ratio.iloc[0]}
    names = ("restitution", "duration_ratio", "restitution_order", "duration_order", "order")
    if not (group.status == "ok").all():
        return row | dict.fromkeys(names, np.nan)
    limit = contact_limit(row["e"], group.restitution.to_numpy(), ratio.to_numpy())
    return row | dict(zip(names, (limit.restitution, limit.duration, *limit.orders), strict=True))


def _signed(values: Frame) -> str:
    known = values.dropna()
    return number(known.loc[known.abs().idxmax()], 2) if len(known) else "-"


def _range(values: Frame) -> str:
    known = values.dropna()
    if not len(known):
        return "-"
    low, high = number(known.min()), number(known.max())
    return low if low == high else f"{low} to {high}"


def write(calibration: Calibration, root: Path) -> None:
    """Write ``calibration.csv``, ``limits.csv``, ``calibration.md``, ``calibration.png`` and ``.pdf``."""
    for name, table in (("calibration", calibration.steps), ("limits", calibration.limits)):
        with replacing(root / f"{name}.csv") as temporary:
            table.to_csv(temporary, index=False, lineterminator="\n")
    save(_draw(calibration), root, "calibration", dpi=150)
    page = render(
        "calibration.md.j2",
        m1=M1,
        m2=M2,
        v0=V0,
        limits={engine: calibration.limit_rows(engine) for engine in calibration.versions},
        naive=calibration.naive_rows(),
        columns=[(name, *about) for name, about in COLUMNS.items()],
        **calibration.summary(),
    )
    write_text(root / "calibration.md", page)


def _draw(calibration: Calibration) -> Figure:
    """Draw convergence in the step, and restitution and duration by both mappings."""
    with drawing(11.0, 3.6) as figure:
        by_step, by_e, by_k = figure.subplots(1, 3)
        for position, engine in enumerate(calibration.versions):
            style = look(engine, position)
            _convergence(by_step, calibration, engine, style)
            for mapping, line, marker in (("calibrated", "-", style.marker or None), ("naive", ":", None)):
                limits = calibration.errors(engine, mapping)
                if not limits.restitution_at_step.notna().any():
                    continue
                drawn = {"color": style.color, "linestyle": line, "marker": marker}
                for ax, axis, value in (
                    (by_e, "e", "restitution_at_step"),
                    (by_k, "k", "duration_ratio_at_step"),
                ):
                    middle, low, high = (getattr(limits.groupby(axis)[value], s)() for s in _STATISTICS)
                    ax.plot(middle.index, middle, label=f"{engine}, {mapping}", **drawn)
                    ax.fill_between(middle.index, low, high, color=style.color, alpha=0.15, linewidth=0)
        by_step.set(xscale="log", yscale="log", xlabel="time step / contact period (-)")
        by_step.set_ylabel("error of restitution (-)")
        by_step.set_xticks(
            STEP_FRACTIONS, [f"{1e3 * fraction:g}e-3" for fraction in STEP_FRACTIONS], minor=False
        )
        by_step.xaxis.set_minor_locator(NullLocator())
        by_step.invert_xaxis()
        by_e.plot([0.2, 1], [0.2, 1], color="0.4", linewidth=0.8)
        by_e.set(xlabel="restitution asked for (-)", ylabel="restitution obtained (-)")
        by_k.set(xscale="log", xlabel="stiffness asked for (N/m)")
        by_k.set_ylabel("duration / duration asked for (-)")
        titles = ("a  calibrated, in the step", "b  restitution", "c  duration")
        for ax, title in zip((by_step, by_e, by_k), titles, strict=True):
            ax.set_title(title, loc="left", fontsize=9)
        for ax in (by_step, by_e):
            if ax.get_legend_handles_labels()[0]:
                ax.legend()
    return figure


_STATISTICS = ("median", "min", "max")


def _convergence(ax: Any, calibration: Calibration, engine: str, style: Any) -> None:
    steps = calibration.steps
    rows = steps[
        (steps.engine == engine) & (steps.mapping == "calibrated") & (steps.status == "ok") & (steps.e < 1)
    ]
    if not len(rows):
        return
    worst = (rows.restitution - rows.e).abs().groupby(rows.step_fraction).max().clip(lower=_FLOOR)
    ax.plot(worst.index, worst, color=style.color, marker=style.marker or None, label=engine)
    fraction = np.array([worst.index.min(), worst.index.max()])
    first_order = 0.7 * worst.iloc[-1] * fraction / fraction[-1]
    ax.plot(fraction, first_order, color="0.4", linewidth=0.8, zorder=1)
