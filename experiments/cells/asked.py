"""Which cell is asked for by the address of the explorer: parameters as after a question mark, all of them optional."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any
from urllib.parse import parse_qsl

from impact_xval.experiments.config.arrangements import Arranged
from impact_xval.experiments.config.cells import collision_of
from impact_xval.experiments.config.errors import UserError, validated
from impact_xval.experiments.config.experiment import Config, parse_config
from impact_xval.model.collision import Collision

#: Most balls of a column in the explorer: more have no room, neither in its table nor in the time of a redraw.
MOST_BALLS = 50
#: Seconds after which a solver is ended there.
LONGEST = 120.0

#: Kinds of cell.
COLLISION, COLUMN = "collision", "column"


@dataclass(frozen=True, slots=True)
class Control:
    """A parameter of a cell, as it is typed and as a slider moves it.

    Attributes
    ----------
    key, label : str
        In an address, and for a reader.
    low, high, step : float
        Of the slider; of a logarithmic one those of the power of ten.
    default : str
        As typed.
    log : bool
        Whether the slider is logarithmic.
    """

    key: str
    label: str
    low: float
    high: float
    step: float
    default: str
    log: bool = False

    @property
    def marks(self) -> list[str]:
        """What stands below the slider, at equal distances."""
        spaces = 4 if self.high - self.low in (4, 8) else 2  # whole powers of ten
        values = [self.low + i * (self.high - self.low) / spaces for i in range(spaces + 1)]
        return [f"{10**value:g}" if self.log else f"{value:g}" for value in values]


#: Of each kind of cell, in the order in which they are shown.
CONTROLS = {
    COLLISION: (
        Control("stiffness_ratio", "k2/k1, stiffness of table over balls", -4, 4, 0.01, "40", True),
        Control("mass_ratio", "m2/m1, mass of lower ball over upper", -2, 2, 0.01, "1.1547", True),
        Control("e1", "e1, restitution of ball on ball", 0, 1, 0.01, "0.9"),
        Control("e2", "e2, restitution of ball on table", 0, 1, 0.01, "0.7"),
    ),
    COLUMN: (
        Control("balls", "N, number of balls", 2, 20, 1, "5"),
        Control("strike", "balls that strike the others, of a cradle", 1, 19, 1, "1"),
        Control("e", "e, restitution of every contact", 0, 1, 0.01, "0.95"),
        Control("mass_taper", "mass of every ball over the one before", -1, 1, 0.01, "1", True),
        Control("stiffness_taper", "stiffness of every contact, likewise", -1, 1, 0.01, "1", True),
    ),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Asked:
    """A cell that was asked for.

    Attributes
    ----------
    config : Config
        How it is solved; of two balls its figure cell is the cell.
    arranged : Arranged or None
        The column; None for two balls.
    """

    config: Config
    arranged: Arranged | None = None

    @property
    def problem(self) -> Collision:
        """What solvers solve."""
        if self.arranged is None:
            return collision_of(self.config, self.config.figure_cell)
        return self.arranged.column()


def asked(query: str) -> Asked:
    """Read a cell.

    Parameters
    ----------
    query : str
        As after the question mark of an address: ``kind``, ``collision`` (the default) or ``column``, and parameters
        of that kind.

    Raises
    ------
    UserError
        If anything is illegal: it names the parameter, the value and what is legal.
    """
    given = dict(parse_qsl(query, keep_blank_values=True))
    kind = given.pop("kind", COLLISION)
    if kind not in CONTROLS:
        raise UserError(f"kind = {kind!r:.60}; legal: {COLLISION!r}, {COLUMN!r}")
    values = {control.key: control.default for control in CONTROLS[kind]}
    if kind == COLUMN:
        values |= {"arrangement": "cradle"}
    unknown = [key for key in given if key not in values]
    if unknown:
        raise UserError(f"{unknown[0]!r:.60} is no parameter of a {kind}; legal: {', '.join(values)}")
    if kind == COLLISION:
        return _collision(values | given)
    if given.get("arrangement", "cradle") != "cradle":
        del values["strike"]
        given.pop("strike", None)
    return _column(values | given)


def _collision(values: Mapping[str, str]) -> Asked:
    cell = {key: _number(key, text) for key, text in values.items()}
    data = {"scenario": "impact", "cell_timeout": LONGEST, "figure_cell": cell}
    return Asked(parse_config(data, where="", name=_last))


def _column(values: Mapping[str, str]) -> Asked:
    data: dict[str, Any] = {
        key: text if key == "arrangement" else _number(key, text) for key, text in values.items()
    }
    if data["balls"] > MOST_BALLS:
        raise UserError(f"balls = {values['balls']}; legal here: at most {MOST_BALLS}")
    config = parse_config({"scenario": "impact", "cell_timeout": LONGEST}, where="")
    return Asked(config, validated(Arranged, data, "", _last))


def _last(location: Any) -> str:
    """Name what is illegal as in the address."""
    return str(location[-1]) if location else "parameters"


def _number(key: str, text: str) -> float | int:
    try:
        return int(text) if key in ("balls", "strike") else float(text)
    except ValueError:
        raise UserError(f"{key} = {text!r:.60}; legal: a number") from None
