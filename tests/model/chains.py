"""Helpers for chains: solve a chain by the model, and compare an outcome with the integration in time."""

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
    """Assert that an outcome has the velocities (to `bound`), the status and the states of an integration in time.

    The integration finds events by sign changes and can miss two that are close together. If it disagrees, it is
    repeated with shorter steps, up to twice.
    """
    theirs = None
    for resolution in (0.1, 0.05, 0.02):
        # the integration may find the same two events again and again, until it gives up
        with suppress(AssertionError):
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
