"""Options that describe one collision, in a command or in the address of the explorer's page.

`parse_collision` makes a collision from the options. Validation of a `Config` decides what is legal. An error is one
line that names the option, the value and the legal values. NumPy is imported only when options are parsed, because help
texts show the options and must appear at once.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from impact_xval.experiments.config.errors import UserError, validate

if TYPE_CHECKING:
    from impact_xval.experiments.config.arrangements import ChainSetup
    from impact_xval.experiments.config.experiment import Config
    from impact_xval.model import Collision

#: Options that decide the outcome of an impact of two balls.
RATIOS = ("stiffness_ratio", "mass_ratio", "e1", "e2")
#: Options of a chain that are whole numbers.
_COUNTS = "balls", "strike"
#: Options that only a chain of N balls has, except the arrangement. The options m1 and k1 give the first mass and the
#: first stiffness of a chain.
OF_CHAIN = (*_COUNTS, "e", "exponent", "gap", "mass_taper", "stiffness_taper")
#: Options that only two balls on a table have.
_OF_TWO = (*RATIOS, "m2", "k2", "gravity")

#: Options that describe one collision or chain, and options for the solvers. Each has its placeholder in the help and
#: its meaning.
PARAMETERS = {
    "stiffness_ratio": ("R", "k2/k1, from 0 to inf."),
    "mass_ratio": ("R", "m2/m1, greater than 0."),
    "e1": ("E", "Restitution of ball on ball, 0 to 1."),
    "e2": ("E", "Restitution of ball on table, 0 to 1."),
    "m1": ("KG", "Mass of the first ball; by default 1."),
    "m2": ("KG", "Mass of the lower ball, instead of m2/m1."),
    "k1": ("N/M", "Stiffness of the first contact; by default 1e8."),
    "k2": ("N/M", "Stiffness of ball on table, instead of k2/k1."),
    "v0": ("M/S", "Velocity of balls that fall or strike; by default -1."),
    "scenario": ("NAME", "'impact' (no gravity, the default) or 'drop'."),
    "gravity": ("G", "Gravity in a drop, in m/s^2; by default 9.81."),
    "arrangement": ("NAME", "Setup of N balls: 'row', 'cradle', 'pile' or 'stack'."),
    "balls": ("N", "Number of balls; by default 5."),
    "strike": ("J", "Number of balls that strike in a cradle; by default 1."),
    "e": ("E", "Restitution of a chain's contacts; by default 0.95."),
    "exponent": ("P", "Exponent of forces k delta^p, 1 to 3; Hertz: 1.5."),
    "gap": ("M", "Gap of every contact, except the one that is struck."),
    "mass_taper": ("R", "Mass ratio of each ball to the ball before it."),
    "stiffness_taper": ("R", "Stiffness ratio of each contact to the one before it."),
    "step_fraction": ("X", "Time step over the shortest contact period, up to 0.2."),
    "cell_timeout": ("S", "Time limit of each solver in s; by default 300."),
}


def parse_collision(
    parameters: Mapping[str, str | None],
) -> tuple[Collision, ChainSetup | None, Config]:
    """Return the collision that options describe, the setup if it is a chain, and the settings of the solvers.

    The setup is None for two balls.

    The options describe two balls, by ratios or in SI units, or a chain of N balls.

    Parameters
    ----------
    parameters : mapping of str to str or None
        Texts of the options in `PARAMETERS`, None for an option that was not typed.

    Raises
    ------
    UserError
        If an option is illegal; the message names it.
    """
    given = {key: value for key, value in parameters.items() if value is not None}
    for key in given:
        if key not in PARAMETERS:
            raise UserError(f"{key!r:.60} is no parameter; legal: {', '.join(PARAMETERS)}")
    chain_key = next((key for key in ("arrangement", "balls") if key in given), None)
    for key in _OF_TWO if chain_key else OF_CHAIN:
        if key in given:
            legal = f"none beside {_option(chain_key)}" if chain_key else "with --arrangement, of N balls"
            raise UserError(f"{_option(key)} = {given[key]!r:.60}; legal: {legal}")
    plain = {key: _number_or_text(value) for key, value in given.items()}
    return _parse_chain(plain) if chain_key else _parse_two_balls(plain)


def parse_settings(parameters: Mapping[str, str | None]) -> Config:
    """Return the configuration with which a contact graph is solved, from the texts of options."""
    from impact_xval.experiments.config.experiment import Config

    plain = {key: _number_or_text(value) for key, value in parameters.items() if value is not None}
    return validate(Config, {"scenario": "impact", **plain}, "", name=_option_of_key)


def _parse_two_balls(plain: dict[str, float | str]) -> tuple[Collision, None, Config]:
    from impact_xval.experiments.config.axes import RATIO_OF
    from impact_xval.experiments.config.cells import collision_of
    from impact_xval.experiments.config.experiment import Config

    for ratio, (upper, lower) in RATIO_OF.items():
        if upper in plain:
            if ratio in plain:
                raise UserError(f"{_option(ratio)} and --{upper} are given; legal: one of both")
            if lower not in plain:
                raise UserError(f"--{upper} without --{lower}; legal: both, or {_option(ratio)}")
            over = _positive(upper, plain.pop(upper), (0, math.inf))
            plain[ratio] = over / _positive(lower, plain[lower])
    missing = [_option(key) for key in RATIOS if key not in plain]
    if missing:
        raise UserError(
            f"{', '.join(missing)} missing; legal: k2/k1 and m2/m1, or --m1 --m2 --k1 --k2, with --e1 and --e2"
        )
    cell = {key: plain.pop(key) for key in RATIOS}
    # A grid of one cell replaces the built-in grid. With m1, k1 or v0 from the options, numbers of the built-in grid
    # could overflow, although the collision of the options is legal.
    grid = {key: [1.0] for key in cell}
    data = {"scenario": "impact", "figure_cell": cell, "grid": grid, **plain}
    config = validate(Config, data, "", name=_option_of_key)
    return collision_of(config, config.figure_cell), None, config


def _positive(key: str, value: float | str, limits: Sequence[float] = ()) -> float:
    """Return the number that an option gives if it is positive and finite, or one of the numbers in `limits`.

    For any other value a `UserError` names the option.
    """
    if isinstance(value, str) or not (0 < value < math.inf or value in limits):
        raise UserError(f"--{key} = {value!r:.60}; legal: a number > 0")
    return value


def _parse_chain(plain: dict[str, float | str]) -> tuple[Collision, ChainSetup, Config]:
    from impact_xval.experiments.config.experiment import Config

    setup = {key: plain.pop(key) for key in (*OF_CHAIN, "arrangement", "v0") if key in plain}
    setup |= {key[0]: plain.pop(key) for key in ("m1", "k1") if key in plain}
    for key in _COUNTS:
        if isinstance(value := setup.get(key), float) and value.is_integer():
            setup[key] = int(value)
    config = validate(Config, {"chain": {}, "figure_chain": setup, **plain}, "", name=_option_of_key)
    return config.figure_chain.collision(), config.figure_chain, config


def _number_or_text(text: str) -> float | str:
    """Return a text as a number if it is one; otherwise return the text unchanged, for validation to check."""
    try:
        return float(text)
    except ValueError:
        return text


def _option_of_key(location: Sequence[str | int]) -> str:
    """Return the name of the option that sets a key of a configuration.

    The name is empty if an error is about several values together. The message then names these values itself.
    """
    key = str(location[-1]) if location else "figure_chain"
    return "" if key == "figure_chain" else _option({"m": "m1", "k": "k1"}.get(key, key))


def _option(key: str) -> str:
    return "--" + key.replace("_", "-")
