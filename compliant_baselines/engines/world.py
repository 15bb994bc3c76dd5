"""A scene as an engine has set it up: what an adapter gives, and `stepping` follows."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping

from impact_xval.compliant_baselines.engines.scene import Floats


class World(ABC):
    """One scene in an engine, at t = 0."""

    #: At t = 0, in m, as the engine has them, counted as those of a scene; shape (N,).
    heights: Floats
    #: What the engine says it will use, read back after setting it: ``"stiffness"`` (N/m), ``"damping"`` (N s/m),
    #: ``"restitution"``, one a contact; ``"step"`` (s), ``"threshold"`` (the speed of approach in m/s below which it
    #: drops restitution), one number. What is not said is not compared with what was asked for.
    effective: Mapping[str, tuple[float, ...]]
    #: How deep a settled lowest ball rests, in m; 0 if nothing is settled, or on a rigid support.
    rest: float = 0.0
    #: Impulse in a step, over the momenta before and after it, that rounding alone can make. An engine updates a
    #: velocity by one or two additions, each good to half a unit in the last place, and makes the increment from a
    #: handful of products; 64 units leave an order of magnitude above that, and in double precision lie, at a step of
    #: 1/1000 of a period, eleven orders below the impulse per step of a fully loaded contact.
    rounding: float = 64 * 2.0**-52
    #: Steps that `leap` takes at most, between events that stiffness and damping as effective foretell
    #: (`engines.quiet`); 0 for an engine that is read after every step.
    longest_leap: int = 0

    @abstractmethod
    def advance(self, n: int) -> tuple[Floats, Floats]:
        """Take up to n steps, at least one; velocities in m/s and heights in m after each, shape (steps, N).

        A RuntimeError says that the engine broke, and why.
        """

    @abstractmethod
    def weightless(self, velocities: Floats, heights: Floats) -> None:
        """Go on without gravity from the state after a step that was given, shape (N,) each."""

    def leap(self, n: int) -> tuple[int, Floats, Floats]:
        """Take up to n steps that nobody reads: how many, and velocities and heights after the last, shape (N,)."""
        velocities, heights = self.advance(n)
        return len(velocities), velocities[-1], heights[-1]
