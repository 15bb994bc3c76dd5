r"""The linear complementarity problem of impacts: 0 <= p, 0 <= G p + q, and one of the two 0 at each contact.

G is symmetric and positive definite, so this is the condition of Karush, Kuhn and Tucker of one strictly convex
problem,

    minimise  1/2 p^T G p + q^T p   over  p >= 0,

whose gradient is G p + q: necessary and sufficient, and with one solution (Cottle, Pang and Stone, The Linear
Complementarity Problem, theorem 3.1.6). With Cholesky's G = L L^T, twice that is |L^T p + L^-1 q|^2 less a constant: a
problem of non-negative least squares, which scipy's `nnls` (Lawson and Hanson's active sets) solves in finitely many
steps. What it is taken for is the set of contacts with an impulse; on it G p = -q is solved directly.
"""

from __future__ import annotations

import numpy as np

from impact_xval.compliant_baselines.rigid.row import Floats

#: Condition number of G up to which p is found: its reciprocal times the rounding of G is what is left of digits.
MOST_CONDITION = 1e6


def solve_lcp(G: Floats, q: Floats) -> Floats:
    """Find p.

    Parameters
    ----------
    G : ndarray, shape (n, n)
        Symmetric, positive definite.
    q : ndarray, shape (n,)

    Returns
    -------
    ndarray, shape (n,)
        Exactly 0 where a contact has no impulse.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the condition number of G, in which masses stand, is above `MOST_CONDITION`.
    RuntimeError
        If `nnls` gives up.
    """
    from scipy.optimize import nnls  # a second to import, which a command without a rigid law does not need

    p = np.zeros_like(q)
    if (q >= 0).all():
        return p
    if not np.linalg.cond(G) <= MOST_CONDITION:
        raise np.linalg.LinAlgError(f"condition number {np.linalg.cond(G):.1e}")
    L = np.linalg.cholesky(G)
    found, _ = nnls(L.T, -np.linalg.solve(L, q))
    active = np.flatnonzero(found)
    # Rounding may leave a contact that only just has none with less than no impulse.
    p[active] = np.maximum(np.linalg.solve(G[np.ix_(active, active)], -q[active]), 0.0)
    return p
