"""Configuration of a test of the hypothesis that an infinitely stiff pair of bodies acts as one body.

The configuration is read from a TOML file and checked. An empty file gives the built-in configuration. The module `run`
and the command `impact-xval hypothesis` use the configuration.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field, ValidationInfo, field_validator, model_validator

from impact_xval.experiments.config.axes import Strict, at_most_field, table_field, whole_field
from impact_xval.experiments.config.errors import read_toml, shorten, validate
from impact_xval.experiments.config.experiment import Config, Solvers
from impact_xval.experiments.config.renamed import HYPOTHESIS_KEYS, rename_keys

#: Exact laws that a test of the hypothesis uses by default. It also uses the default solvers of a run.
LAWS = ("kelvin-voigt-anchored", "kelvin-voigt-textbook", "hunt-crossley", "liu-zhao-brogliato")


def _in_order(value: tuple[float, float], info: ValidationInfo) -> tuple[float, float]:
    """Return a range of contrasts if the range is legal; otherwise raise a ValueError.

    A contrast is a stiffness ratio. Above the largest legal contrast double precision does not suffice.
    """
    most = "1e16" if info.field_name == "plastic_contrast" else "1e10"
    if not 1 < value[0] < value[1] <= float(most):
        raise ValueError(f"{shorten(list(value))}; legal: [lo, hi] with 1 < lo < hi <= {most}")
    return value


#: Range of contrasts, least and largest. A list is accepted, because TOML has no tuples. Each entry of the list must be
#: a number in TOML too, and not a text.
_Contrast = Annotated[
    tuple[float, float], Field(strict=False, description="[lo, hi]"), AfterValidator(_in_order)
]
_Decades = Annotated[float, Field(ge=1, le=8, description="from 1 to 8 (decades of a fit)")]


class ChainsConfig(Strict):
    """The part of a test that is about chains of N balls: how many chains, their sizes, and the contrasts."""

    points: int = whole_field(6, 3, 100, " (chains at each place; every third is elastic)")
    balls: tuple[int, int] = Field(
        (4, 7), strict=False, description="whole numbers from 4 to 12, least first"
    )
    contrast: _Contrast = (1e1, 1e6)  # stiffness of the stiff contact over the largest other stiffness
    per_decade: int = whole_field(4, 4, 64, " (contrasts in a decade)")
    fit_decades: _Decades = 3.0

    @field_validator("balls")
    @classmethod
    def _check_balls(cls, value: tuple[int, int]) -> tuple[int, int]:
        if not 4 <= value[0] <= value[1] <= 12:
            raise ValueError(f"{list(value)}; legal: {cls.model_fields['balls'].description}")
        return value


class HypothesisConfig(Strict):
    """Configuration of a whole test of the hypothesis, for pairs of balls on a table and for chains."""

    @model_validator(mode="before")
    @classmethod
    def _names_of_today(cls, data: object) -> object:
        return rename_keys(data, HYPOTHESIS_KEYS, warn=True)

    seed: int = Field(1, ge=0, le=2**32, description="a whole number from 0 to 2^32")
    points: int = whole_field(24, 6, 500, " (points of each limiting case)")
    solvers: Solvers = Field([*Config.model_fields["solvers"].default, *LAWS])
    contrast: _Contrast = (1e1, 1e8)  # k1/k2 or k2/k1
    plastic_contrast: _Contrast = (1e1, 1e12)  # 1/e^2
    per_decade: int = whole_field(8, 4, 64, " (contrasts in a decade)")
    fit_decades: _Decades = 4.0
    cell_timeout: float = at_most_field(300.0, 1e6, "s of wall time")
    chains: ChainsConfig = table_field(ChainsConfig)


def spaced_contrasts(ends: tuple[float, float], per_decade: int) -> list[float]:
    """Return rising contrasts, `per_decade` in each decade.

    The largest contrast is the upper end of the range, and the other contrasts are spaced downwards from it. So each of
    the last whole decades of the range begins exactly at one of the contrasts.
    """
    low, high = map(math.log10, ends)
    whole = math.floor((high - low) * per_decade + 1e-9)
    return np.logspace(high - whole / per_decade, high, whole + 1).tolist()


def load_hypothesis_config(path: Path | None) -> HypothesisConfig:
    """Return the configuration in a TOML file, or the built-in configuration if `path` is None.

    A `UserError` says in one line what is illegal in the file.
    """
    where = str(path) if path else "built-in hypothesis"
    return validate(HypothesisConfig, read_toml(path) if path else {}, where)
