"""The table of docs/parity.md: what each solver answers. ``python docs/hooks/parity.py`` prints it."""

from __future__ import annotations

from collections.abc import Iterable

from impact_xval.compliant_baselines import Settings, get_solver, solver_names
from impact_xval.compliant_baselines.contract.registry import is_ours, kind_of, law_of
from impact_xval.model import Collision, Column

#: A collision, and one thing about it that a solver may not represent.
COLLISIONS: dict[str, tuple[dict[str, float], Settings]] = {
    "e1 = e2 = 0.9": ({}, Settings()),
    "e2 = 0.7": ({"e2": 0.7}, Settings()),
    "e1 = 0": ({"e1": 0.0}, Settings()),
    "e1 = e2 = 1": ({"e1": 1.0, "e2": 1.0}, Settings()),
    "k2/k1 = 0": ({"stiffness_ratio": 0.0}, Settings()),
    "k2/k1 = inf": ({"stiffness_ratio": float("inf")}, Settings()),
    "gravity": ({}, Settings(scenario="drop")),
    "naive mapping": ({}, Settings(mapping="naive")),
}
USUAL = {"stiffness_ratio": 1.0, "mass_ratio": 1.1547, "e1": 0.9, "e2": 0.9}

#: A cradle of three balls, with linear contacts, those of Hertz, and a gap.
CRADLE = Column((1.0, 1.0, 1.0), (1e8, 1e8), (0.9, 0.9), (-1.0, 0.0, 0.0))
APART = Column((1.0, 1.0, 1.0), (1e8, 1e8), (0.9, 0.9), (-1.0, 0.0, 0.0), gaps=(0.0, 1e-4))
COLUMNS = {"3 balls": (CRADLE, 1.0), "3 balls, Hertz": (CRADLE, 1.5), "3 balls, a gap": (APART, 1.0)}

HEAD = ("solver", "kind", "law", *COLLISIONS, *COLUMNS)


def row(name: str) -> tuple[str, ...]:
    """Cells of one solver: the status of each answer, `yes` for ``ok``."""
    solver = get_solver(name)
    answers = [
        solver.solve_many([Collision.from_ratios(**USUAL | change)], settings)[0].status
        for change, settings in COLLISIONS.values()
    ]
    for column, exponent in COLUMNS.values():
        found = solver.solve_columns([column], Settings(), exponent)
        answers.append(found[0].status)
    words = {"ok": "yes", "limit": "yes (limit)", "unrepresentable": "no"}
    return (f"`{name}`", kind_of(name), law_of(name), *(words.get(status, status) for status in answers))


def rows(names: Iterable[str] | None = None) -> list[tuple[str, ...]]:
    """Cells of all solvers of this project."""
    return [row(name) for name in names or filter(is_ours, solver_names(on_request=True))]


def table() -> str:
    """Give the table as Markdown."""
    lines = [HEAD, ("---",) * len(HEAD), *rows()]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


if __name__ == "__main__":
    print(table())
