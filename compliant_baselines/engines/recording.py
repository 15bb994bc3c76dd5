"""Following one column through the steps an engine takes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from impact_xval.compliant_baselines.contact.column import Column
from impact_xval.compliant_baselines.contract.state_runs import Runs
from impact_xval.compliant_baselines.contract.trajectory import (
    BROKEN,
    FLIGHT,
    GOING,
    Floats,
    ScanParameters,
    new_memory,
    scan,
)
from impact_xval.compliant_baselines.engines.engine_run import Run
from impact_xval.compliant_baselines.engines.quiet import Law, between, quiet_steps

#: A recorded path has about as many points as this between the borders of its states.
PATH_POINTS = 2000


class Recorder:
    """Takes the steps of one column as an engine delivers them, in blocks, until the collision is over.

    Parameters
    ----------
    column : Column
        What the engine was asked.
    x1, x2 : float
        Heights at t = 0 in m, as the engine has them.
    k2 : float
        Stiffness in N/m of the support as the engine has it, about static equilibrium.
    max_steps : int
        Steps it may take.
    record_path : bool
        Whether to keep points.
    law : Law, optional
        The contacts as the engine has them; needed by an adapter that takes several steps together.
    """

    def __init__(
        self,
        column: Column,
        x1: float,
        x2: float,
        k2: float,
        max_steps: int,
        record_path: bool,
        law: Law | None = None,
    ) -> None:
        self.column = column
        self._max_steps = max_steps
        self.end = GOING
        self._k2 = k2
        rest = -column.m2 * column.gravity / k2
        self.parameters = ScanParameters(
            column.step, column.gravity, column.m1, column.m2, column.contact1.k, k2, rest
        )
        self._v = np.array([column.v1, column.v2])
        self._x = np.array([x1, x2])
        self._start = (x1, x2)
        self.n_steps = 0
        self._last_code = 0
        self._law = law
        self._packed = self._pack()
        self._fall: tuple[int, float, float] | None = None
        self._memory = new_memory()
        self._starts: list[NDArray[np.int64]] = []
        self._states: list[NDArray[np.int64]] = []
        self._points = [np.array([[0.0, column.v1, column.v2]])] if record_path else None
        self._n_points, self._stride = 1, 1

    def _pack(self) -> Floats | None:
        return np.array([*self.parameters, *self._law]) if self._law is not None else None

    @property
    def state(self) -> tuple[Floats, Floats]:
        """Heights in m and velocities in m/s after the last step taken, shape (2,) each."""
        return self._x, self._v

    def feed(self, v: Floats, x: Floats) -> int:
        """Take the next steps, up to the one after which the collision is over, given up or in its first flight.

        Parameters
        ----------
        v, x : ndarray, shape (n, 2)
            Velocities in m/s and heights in m of B1 and B2 after each step.

        Returns
        -------
        int
            `GOING`; `FLIGHT` if the engine has to go on from `state` without gravity; else these were the last.
        """
        codes = np.empty(len(v), np.int8)
        left = self._max_steps - self.n_steps - len(v)
        n, self.end = scan(v, x, self._v, self.parameters, left, codes, self._memory)
        codes = codes[:n]
        if n:
            changes = np.flatnonzero(np.diff(codes, prepend=np.int8(self._last_code)))
            self._starts.append(changes + self.n_steps)
            self._states.append(codes[changes].astype(np.int64))
            if self._points is not None:
                self._keep(v[:n], changes)
            self._v, self._x = v[n - 1].copy(), x[n - 1].copy()
            self._last_code = int(codes[-1])
            self.n_steps += n
        if self.end == FLIGHT:
            self._fall = self.n_steps, float(self._x[0]), float(self._x[1])
            self.parameters = self.parameters._replace(g=0.0)
            self._packed = self._pack()
            self.end = GOING
            return FLIGHT
        return self.end

    def quiet_steps(self) -> int:
        """Count the next steps in which nothing will happen (`engines.quiet`)."""
        assert self._packed is not None
        return quiet_steps(self._last_code, self._v, self._x, self._packed)

    def skip(self, n: int, v: Floats, x: Floats) -> None:
        """Take n steps together, in which nothing happened: as in the last one that was fed, all along.

        Points of the path in between lie on the cubics through the velocities and accelerations at both ends,
        the accelerations from the law. That is of fourth order in the time of the n steps, and of first in their
        own: within 6e-5 of |v0| of what each step would have given, for 32 steps of 1/1000 of a period.

        Parameters
        ----------
        n : int
            Number of steps.
        v, x : ndarray, shape (2,)
            Velocities in m/s and heights in m of B1 and B2 after the last of them.
        """
        if self._points is not None:
            assert self._packed is not None
            ends = (self._v, self._x, v, x)
            self._append(between(self._last_code, *ends, self.n_steps, n, self._stride, self._packed))
        self._v, self._x = v, x
        self.n_steps += n
        self._memory[3] += n

    def _keep(self, v: Floats, changes: NDArray[np.int64]) -> None:
        """Keep every `stride`-th point, the borders, and the last one of the block."""
        assert self._points is not None
        number = self.n_steps + 1 + np.arange(len(v))
        wanted = number % self._stride == 0
        wanted[-1] = True
        wanted[changes[changes > 0] - 1] = True
        self._append(np.column_stack([number[wanted].astype(np.float64), v[wanted]]))

    def _append(self, points: Floats) -> None:
        assert self._points is not None
        self._points.append(points)
        self._n_points += len(points)
        if self._n_points > 4 * PATH_POINTS:
            self._thin(PATH_POINTS)

    def _thin(self, limit: int) -> Floats:
        """Double the stride until the points between borders fit the limit."""
        assert self._points is not None
        points = np.concatenate(self._points)
        number = points[:, 0].astype(np.int64)
        border = (
            np.isin(number, np.concatenate(self._starts)) if self._starts else np.zeros(len(number), bool)
        )
        border[[0, -1]] = True
        keep = np.ones(len(number), bool)
        while np.count_nonzero(keep & ~border) > limit:
            self._stride *= 2
            keep = border | (number % self._stride == 0)
        self._points = [points[keep]]
        self._n_points = len(self._points[0])
        return self._points[0]

    def finish(self, failure: str = "") -> Run:
        """Close the record."""
        empty = np.zeros(0, np.int64)
        raw = Runs(
            np.concatenate(self._starts) if self._starts else empty,
            np.concatenate(self._states) if self._states else empty,
            self.n_steps,
        )
        points = self._thin(PATH_POINTS) if self._points is not None else None
        end = BROKEN if failure else self.end
        v1, v2 = map(float, self._v)
        x1, x2 = map(float, self._x)
        again, unloaded1, unloaded2 = map(float, self._memory[:3])
        return Run(
            self.column,
            end,
            v1,
            v2,
            x1,
            x2,
            *self._start,
            raw,
            points,
            failure,
            again,
            (unloaded1, unloaded2),
            self._max_steps,
            self._fall,
            (float(self._memory[15]) * self.column.step, int(self._memory[16])),
        )
