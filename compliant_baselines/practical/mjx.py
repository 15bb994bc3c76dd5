"""MuJoCo compiled by JAX (MJX) on a processor, in double precision: the scene of `mujoco_user`, as it is shipped.

A step is MuJoCo's own in another implementation (Euler, Newton's solver). On a processor it takes a hundred times as
long, which is why it has the default contacts only, whose impacts are over in tens of steps.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from typing import Any

from impact_xval.compliant_baselines.practical.mujoco_user import MujocoDefault, MujocoWorld
from impact_xval.compliant_baselines.practical.practice import Arrangement, Practice, World
from impact_xval.model.columns.column import Column


class MjxDefault(MujocoDefault):
    """MJX as it is shipped, but for double precision."""

    name = "mjx-default"
    settings = "MuJoCo's default solref and solimp by MJX, in double precision"
    distribution = "mujoco-mjx"
    module = "mujoco.mjx"
    way_out = "run pip install 'impact-xval[mjx]'"

    def unavailable(self) -> str | None:
        """MuJoCo is always there, JAX is not."""
        if find_spec("mujoco") is None:
            return super().unavailable()
        return Practice.unavailable(self)

    def load(self) -> object:
        """Import it."""
        return import_module("mujoco.mjx")

    @contextmanager
    def world(self, column: Column, arrangement: Arrangement) -> Iterator[World]:
        """Make the column."""
        with import_module("jax").enable_x64(True):
            yield _World(column, arrangement, self.solrefs(column))


class _World(MujocoWorld):
    def __init__(self, column: Column, arrangement: Arrangement, solrefs: Sequence[Any]) -> None:
        super().__init__(column, arrangement, solrefs)
        mjx: Any = import_module("mujoco.mjx")
        self._there = mjx.put_model(self._model)
        self._state = mjx.put_data(self._model, self._data)
        # Compiled, once a number of balls: for the first state, and for those that a step returns.
        _step()(self._there, _step()(self._there, self._state)).qvel.block_until_ready()

    def step(self) -> None:
        self._state = _step()(self._there, self._state)

    def velocities(self) -> Sequence[float]:
        return [float(self._state.qvel[joint]) for joint in self._upwards]


@cache
def _step() -> Any:
    return import_module("jax").jit(import_module("mujoco.mjx").step)
