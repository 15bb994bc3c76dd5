"""Names that version 0.4 had for things that have another name now.

The tables say what was renamed. The functions translate what a user wrote for 0.4, a TOML file or an option; they are
called by the classes that validate a configuration. `tables.earlier` translates the tables of a run by the tables here,
and the command ``scoreboard`` translates the answers of a baseline. All of this is kept for one release.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping

from impact_xval.experiments.config.errors import TomlTable, is_table

#: Tables and keys of the TOML file of an experiment.
EXPERIMENT_KEYS = {"column": "chain", "figure_column": "figure_chain"}

#: Tables of the TOML file of a test of the hypothesis.
HYPOTHESIS_KEYS = {"columns": "chains"}

#: Arrangements of a chain, in TOML files, options and tables.
ARRANGEMENTS = {"chain": "row", "drop": "pile"}

#: Statuses of an outcome, in tables.
STATUSES = {"limit": "closed-form"}

#: Columns of the tables of a run.
COLUMNS = {"curve_distance": "impulse_curve_distance", "states_part_at": "states_differ_at"}

#: Cases of the scoreboard.
CASES = {f"drop, k2/k1 = {ratio}": f"pile, k2/k1 = {ratio}" for ratio in ("0.01", "1", "100")}


def rename_keys(data: object, names: Mapping[str, str], *, warn: bool) -> object:
    """Return a TOML table with the keys of 0.4 under their new names; anything else as it is.

    A key that stands there under both names keeps the old one, which is then refused as unknown. With `warn` each
    renamed key is told by a `FutureWarning`.
    """
    if not is_table(data):
        return data
    renamed: TomlTable = {}
    for key, value in data.items():
        new = names.get(key, key)
        if new != key and new not in data:
            if warn:
                _warn(f"[{key}]", f"[{new}]")
            renamed[new] = value
        else:
            renamed[key] = value
    return renamed


def rename_arrangement(name: object, *, warn: bool) -> object:
    """Return the new name of an arrangement of 0.4; anything else as it is. With `warn` a `FutureWarning` tells it."""
    if not isinstance(name, str) or name not in ARRANGEMENTS:
        return name
    new = ARRANGEMENTS[name]
    if warn:
        _warn(f"the arrangement {name!r}", repr(new))
    return new


def _warn(old: str, new: str) -> None:
    message = f"{old} is called {new} now; the next release refuses the old name"
    warnings.warn(message, FutureWarning, stacklevel=2)
