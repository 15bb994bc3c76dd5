"""The calibrated adapters of `engines`, at steps that are shares of the shortest contact period.

They lay their balls out themselves, of a radius that goes with the depth of the contacts: what is left of an
`Arrangement` is the gap, in radii of `practice.RADIUS` as everywhere, and the step.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from time import perf_counter

from impact_xval.compliant_baselines.contract.registry import KELVIN_VOIGT
from impact_xval.compliant_baselines.engines.engine import EngineSolver
from impact_xval.compliant_baselines.practical.practice import (
    RADIUS,
    Arrangement,
    Practice,
    Simulated,
    World,
    shortest_period,
    silent,
    springs,
    without_spring,
)
from impact_xval.model.columns.column import Column


class Calibrated(Practice):
    """An adapter of `engines` at a share of the shortest contact period."""

    takes = ("restitution", "stiffness")
    law = KELVIN_VOIGT

    def __init__(self, solver: EngineSolver, engine: str, share: float) -> None:
        self.name = f"{solver.name}-calibrated-{share:g}"
        self.settings = f"every parameter mapped, step {share:g} of the shortest contact period"
        self.engine, self.distribution, self.module = engine, solver.distribution, solver.distribution
        self.share, self._solver = share, solver

    def unavailable(self) -> str | None:
        """As of the adapter."""
        with silent():
            return self._solver.unavailable()

    def load(self) -> object:
        """Import it."""
        return import_module(self.module)

    def usual_step(self, column: Column) -> float:
        """Share of the shortest contact period, in s."""
        return self.share * shortest_period(column)

    def refuses(self, column: Column) -> str | None:
        """As the adapter refuses."""
        refused = without_spring(column)
        if refused:
            return refused
        try:
            return self._solver.line_refusal(springs(column, self.usual_step(column)))
        except ArithmeticError:
            return "periods, penetrations or energies beyond double precision"

    def refuses_arrangement(self, arrangement: Arrangement) -> str | None:
        """Refuse another order and another place."""
        for name in ("reversed_insertion", "translation"):
            if getattr(arrangement, name):
                value = getattr(arrangement, name)
                return f"{name} = {value!r}: the calibrated adapters lay their balls out themselves"
        return None

    @contextmanager
    def world(self, column: Column, arrangement: Arrangement) -> Iterator[World]:
        """Not used: the adapter runs a line by itself."""
        raise NotImplementedError
        yield

    def run(self, column: Column, arrangement: Arrangement) -> Simulated:
        """Run the line of the adapter; its seconds are those of all its work."""
        line = springs(column, arrangement.step)
        line = replace(line, gaps=tuple(gap + arrangement.gap * RADIUS for gap in line.gaps))
        begun = perf_counter()
        run = self._solver.run_lines([line], arrangement.max_steps)[0]
        seconds, steps = perf_counter() - begun, run.raw.n_steps
        if not run.over:
            unknown = (math.nan,) * len(column.masses)
            return Simulated(self.name, unknown, steps, seconds, run.status, run.problem())
        return Simulated(self.name, run.reported, steps, seconds)
