"""The configuration of a test of the hypothesis, as a validated TOML file; the empty file is the built-in one."""

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

#: Models and references beside the solvers that a run has by default.
LAWS = ("kelvin-voigt-anchored", "kelvin-voigt-textbook", "hunt-crossley", "liu-zhao-brogliato")


def _in_order(value: tuple[float, float], info: ValidationInfo) -> tuple[float, float]:
    """Check a range of contrasts; beyond its largest legal end double precision does not suffice."""
    most = "1e16" if info.field_name == "plastic_contrast" else "1e10"
    if not 1 < value[0] < value[1] <= float(most):
        raise ValueError(f"{shorten(list(value))}; legal: [lo, hi] with 1 < lo < hi <= {most}")
    return value


#: A pair of numbers. TOML has lists only, so a list is accepted; its numbers are checked as strictly as others.
_Contrast = Annotated[
    tuple[float, float], Field(strict=False, description="[lo, hi]"), AfterValidator(_in_order)
]
_Decades = Annotated[float, Field(ge=1, le=8, description="from 1 to 8 (decades of a fit)")]


class ChainsConfig(Strict):
    """The chains of N balls."""

    points: int = whole_field(6, 3, 100, " (chains at each place; every third is elastic)")
    balls: tuple[int, int] = Field(
        (4, 7), strict=False, description="whole numbers from 4 to 12, least first"
    )
    contrast: _Contrast = (1e1, 1e6)  # of the stiff contact
    per_decade: int = whole_field(4, 4, 64, " (contrasts in a decade)")
    fit_decades: _Decades = 3.0

    @field_validator("balls")
    @classmethod
    def _check_balls(cls, value: tuple[int, int]) -> tuple[int, int]:
        if not 4 <= value[0] <= value[1] <= 12:
            raise ValueError(f"{list(value)}; legal: {cls.model_fields['balls'].description}")
        return value


class HypothesisConfig(Strict):
    """A test of the hypothesis."""

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
    """Return contrasts, `per_decade` in a decade, counted down from the upper end.

    Windows of whole decades that end at the upper end thus begin on a contrast.
    """
    low, high = map(math.log10, ends)
    whole = math.floor((high - low) * per_decade + 1e-9)
    return np.logspace(high - whole / per_decade, high, whole + 1).tolist()


def load_hypothesis_config(path: Path | None) -> HypothesisConfig:
    """Read a configuration, or the built-in one without a path; a `UserError` says in one line what is illegal."""
    where = str(path) if path else "built-in hypothesis"
    return validate(HypothesisConfig, read_toml(path) if path else {}, where)
