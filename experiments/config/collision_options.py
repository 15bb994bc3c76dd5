"""One collision as it is typed: by the options of a command, or by the parameters of an address.

A configuration judges what is legal; the error is one line that names the option, the value and the legal range.
Nothing heavy is imported before something is asked: the options of help texts stand here.
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

#: What decides an impact.
RATIOS = ("stiffness_ratio", "mass_ratio", "e1", "e2")
#: What a chain of N balls has beside its arrangement; its first mass and stiffness are m1 and k1.
_COUNTS = "balls", "strike"
OF_CHAIN = (*_COUNTS, "e", "exponent", "gap", "mass_taper", "stiffness_taper")
_OF_TWO = (*RATIOS, "m2", "k2", "gravity")

#: Parameters of one collision, or chain, and of how it is solved, each with its unit and meaning.
PARAMETERS = {
    "stiffness_ratio": ("R", "k2/k1, from 0 to inf."),
    "mass_ratio": ("R", "m2/m1, greater than 0."),
    "e1": ("E", "Restitution of ball on ball, 0 to 1."),
    "e2": ("E", "Restitution of ball on table, 0 to 1."),
    "m1": ("KG", "Mass of the first ball; by default 1."),
    "m2": ("KG", "Mass of the lower ball, for --mass-ratio."),
    "k1": ("N/M", "Stiffness of the first contact; by default 1e8."),
    "k2": ("N/M", "Stiffness of ball on table, for --stiffness-ratio."),
    "v0": ("M/S", "Velocity of what falls or strikes; by default -1."),
    "scenario": ("NAME", "'impact' (by default; no gravity) or 'drop'."),
    "gravity": ("G", "Of a drop, in m/s^2; by default 9.81."),
    "arrangement": ("NAME", "N balls: 'row', 'cradle', 'pile' or 'stack'."),
    "balls": ("N", "Number of balls; by default 5."),
    "strike": ("J", "Balls of a cradle that strike; by default 1."),
    "e": ("E", "Restitution of every contact; by default 0.95."),
    "exponent": ("P", "Of forces k delta^p, 1 to 3; 1.5 is Hertz's."),
    "gap": ("M", "Of every contact but the one that is struck."),
    "mass_taper": ("R", "Mass of each next ball over the one before."),
    "stiffness_taper": ("R", "Stiffness of each next contact over the one before."),
    "step_fraction": ("X", "Time step over the shortest contact period, up to 0.2."),
    "cell_timeout": ("S", "Seconds that a solver has; by default 300."),
}


def parse_collision(
    parameters: Mapping[str, str | None],
) -> tuple[Collision, ChainSetup | None, Config]:
    """Make a collision of what is typed for one: two balls by ratios or in SI units, or a chain of N.

    Parameters are those of `PARAMETERS`, typed as options or in an address, None where nothing was. The configuration
    says how the collision is solved. A `UserError` names the option that is illegal.
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
    """Make a configuration of how an impact is solved alone, of parameters as they are typed."""
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
    # The built-in grid may leave double precision where the cell does not.
    grid = {key: [1.0] for key in cell}
    data = {"scenario": "impact", "figure_cell": cell, "grid": grid, **plain}
    config = validate(Config, data, "", name=_option_of_key)
    return collision_of(config, config.figure_cell), None, config


def _positive(key: str, value: float | str, limits: Sequence[float] = ()) -> float:
    """Return a number that is positive and finite, or one of the limits; a `UserError` names the option."""
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
    """Read a number; a text that is none stays as it is, for the configuration to refuse."""
    try:
        return float(text)
    except ValueError:
        return text


def _option_of_key(location: Sequence[str | int]) -> str:
    """Name the option of a key; values that are not legal together are named by what is said of them."""
    key = str(location[-1]) if location else "figure_chain"
    return "" if key == "figure_chain" else _option({"m": "m1", "k": "k1"}.get(key, key))


def _option(key: str) -> str:
    return "--" + key.replace("_", "-")
