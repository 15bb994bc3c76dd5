"""The table of docs/engines-as-run.md: what each practice takes, and what it gives on one contact and on two.

``python -m impact_xval.compliant_baselines.practical.parity`` runs every practice in this process and prints it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from impact_xval.compliant_baselines.practical.practice import Practice, Simulated, single_contact
from impact_xval.compliant_baselines.practical.practices import get_practice, practice_names
from impact_xval.model.columns.column import Column

#: The basic collision: 1 kg at 1 m/s on 2 kg on a table; elastic, and not.
BASIC = Column((1.0, 2.0), (1e4, 1e4), (1.0, 1.0), (-1.0, 0.0), True)

#: Speeds in m/s at which one contact of e = 0.9 is tried on the table.
SPEEDS = (0.01, 0.1, 1.0, 10.0)

#: Gaps in radii at which the basic collision is tried.
GAPS = (-1e-4, -1e-6, 0.0, 1e-6, 1e-4)

HEAD = (
    "practice",
    "engine",
    "precision",
    "takes",
    "step, s",
    "e = 0.9 returns, at " + ", ".join(f"{s:g}" for s in SPEEDS) + " m/s",
)


def rows(names: Sequence[str] | None = None) -> list[tuple[str, ...]]:
    """Cells of the table, one row a practice."""
    return [_row(get_practice(name)) for name in names or practice_names()]


def _row(practice: Practice) -> tuple[str, ...]:
    said = (practice.name, f"{practice.engine} {practice.version()}", practice.precision)
    takes = " and ".join(practice.takes) or "neither"
    step = f"{practice.usual_step(BASIC):.3g}"
    missing = practice.unavailable()
    if missing:
        return (*said, takes, step, missing, "")
    bounces = (single_contact(practice, 0.9, speed) for speed in SPEEDS)
    returned = ", ".join(
        f"{b.returned:.4f}" if b.simulated.status == "ok" else b.simulated.status for b in bounces
    )
    usual = practice.usual(BASIC)
    basic = "; ".join(_velocities(practice.simulate(BASIC, replace(usual, gap=gap))) for gap in GAPS)
    return (*said, takes, step, returned, basic)


def _velocities(simulated: Simulated) -> str:
    """Both velocities, or why there are none."""
    if simulated.status != "ok":
        return simulated.status
    return ", ".join(f"{v:.4f}" for v in simulated.velocities)


def table() -> str:
    """Give the table as Markdown."""
    basic = "basic collision, e = 1, gap " + ", ".join(f"{gap:g}" for gap in GAPS)
    lines = [(*HEAD, basic), ("---",) * (len(HEAD) + 1), *rows()]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


if __name__ == "__main__":
    print(table())
