"""Grazing margins, which tell how near a jump of the model is, agree with an independent computation.

It follows the definition in docs/theory.md, section 6.
"""

from __future__ import annotations

import numpy as np
import pytest

from impact_xval.model import Collision, Collisions, solve_batch, solve_many
from tests.model.grazing_reference import reference

#: k2/k1, m2/m1, e1 and e2 of a cell in which a parabola through the ends of a time window misplaces the turning point.
MISPLACED = (2.2728238145196316, 1.443937280507818, 0.8149456721039552, 0.4998124312877872)


def test_margin_is_exact_where_a_parabola_misplaces_the_turning_point():
    kappa, mu, e1, e2 = MISPLACED
    found = solve_batch(kappa, mu, [e1, 0.998 * e1], e2).grazing_margin
    assert found == pytest.approx([0.010912554648648, 0.008325222809501], rel=1e-9)
    assert found == pytest.approx(
        [reference(Collision.from_ratios(kappa, mu, e, e2))[0] for e in (e1, 0.998 * e1)], rel=1e-9
    )


def test_margin_is_the_defined_one_in_random_cells():
    # Collisions that a closed form finishes are left out: the reference would follow their ringing, the model does not.
    rng = np.random.default_rng(5)
    n = 2000
    cells = np.array([10 ** rng.uniform(-2, 2, n), 10 ** rng.uniform(-1, 1, n), *rng.uniform(0.3, 1, (2, n))])
    found = solve_batch(*cells)
    finite = np.isfinite(found.grazing_margin)
    followed = (found.statuses == "ok") & (found.n_events < 50)
    some = [*np.flatnonzero(followed & finite)[:25], *np.flatnonzero(followed & ~finite)[:25]]
    margins = [reference(Collision.from_ratios(*cells[:, i]))[0] for i in some]
    assert found.grazing_margin[some] == pytest.approx(margins, rel=1e-8)


@pytest.mark.parametrize(("balls", "table"), [(3, False), (4, False), (3, True)])
def test_margin_of_a_chain_is_the_defined_one(balls, table):
    rng = np.random.default_rng(balls + 10 * table)
    n, contacts = 300, balls - 1 + table
    some = [
        Collision(
            tuple(10 ** rng.uniform(-1, 1, balls)),
            tuple(10 ** rng.uniform(-1, 1, contacts)),
            tuple(rng.uniform(0.5, 1, contacts)),
            (-1.0, *(0.0,) * (balls - 1)),
            table=table,
        )
        for _ in range(n)
    ]
    found = solve_many(Collisions.of(some))
    finite = np.isfinite(found.grazing_margin)
    followed = (found.statuses == "ok") & (found.n_events < 40)
    drawn = [*np.flatnonzero(followed & finite)[:12], *np.flatnonzero(followed & ~finite)[:12]]
    margins = [reference(some[i])[0] for i in drawn]
    assert np.isfinite(margins).sum() == 12
    assert found.grazing_margin[drawn] == pytest.approx(margins, rel=1e-7)
