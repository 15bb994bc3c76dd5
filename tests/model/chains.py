"""One chain, or many, by the model, and the agreement of an outcome with the integration in time."""

from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

from impact_xval.model import solve
from tests.model.chain_reference import JME, integrate

PAPER = {"1+2": "S1", "2": "S2", "1": "S3", "-": "S4"}


def solved(chain, *, exponent=1.0, **how):
    return solve(replace(chain, exponent=exponent), **how)


def assert_integrated(ours, chain, law=JME, bound=1e-9):
    """The integration looks at signs, and can miss pairs of events: it is repeated in short steps before it counts."""
    theirs = None
    for resolution in (0.1, 0.05, 0.02):
        with suppress(AssertionError):  # it can also meet a pair again and again
            theirs = integrate(chain, law, resolution=resolution, most=500)
            if np.abs(np.subtract(ours.velocities, theirs.velocities)).max() <= bound:
                break
    assert theirs is not None, chain
    assert ours.velocities == pytest.approx(theirs.velocities, abs=bound, rel=0), chain
    assert (ours.status == "closed-form") == theirs.limit, chain
    if not theirs.limit:
        names = PAPER if chain.table and len(chain.masses) == 2 else {}
        sets = ("+".join(map(str, contacts)) or "-" for contacts in theirs.states)
        assert ours.states == tuple(names.get(s, s) for s in sets), chain
