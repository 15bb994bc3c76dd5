"""One column, or many, by the model."""

from dataclasses import replace

from impact_xval.model import solve


def solved(column, *, exponent=1.0, **how):
    """Solve a collision of N balls with contacts of an exponent."""
    return solve(replace(column, exponent=exponent), **how)
