"""Names of version 0.4 that have changed since, and the translation of old names into new ones.

The dictionaries map old names to new names. The functions translate names in TOML files and options that were written
for 0.4; the classes that validate a configuration call them. `tables.earlier` uses the dictionaries to translate the
tables of a run, and the command ``scoreboard`` to translate the answers of an earlier scoreboard. The project
understands old names for one release.
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
    """Return a TOML table with new names in place of the keys of version 0.4; return any other value unchanged.

    If the table has both the old and the new name of a key, the old name is kept, and validation refuses it as unknown.
    With `warn`, a `FutureWarning` names each key that was renamed.
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
    """Return the new name of an arrangement of version 0.4; return any other value unchanged.

    With `warn`, a `FutureWarning` tells the new name.
    """
    if not isinstance(name, str) or name not in ARRANGEMENTS:
        return name
    new = ARRANGEMENTS[name]
    if warn:
        _warn(f"the arrangement {name!r}", repr(new))
    return new


def _warn(old: str, new: str) -> None:
    message = f"{old} is called {new} now; the next release refuses the old name"
    warnings.warn(message, FutureWarning, stacklevel=2)
