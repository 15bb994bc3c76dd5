"""The grazing margin of a graph: how near the collision is to a jump of its outcome.

The outcome jumps where the rate of compression w_i of an active contact touches zero without crossing it. Therefore all
turning points of these rates, w_i' = 0, are found. At each turning point abs(w_i) is divided by the sum of the
amplitudes of the sinusoids of which w_i then consists. The margin is the smallest quotient (docs/theory.md, section 6).
A turning point is ignored if its quotient is above `NEAR`, or if an end of compression at this time would lose less
than the share `STAKE` of the energy of impact.

**Amplitudes.** With u_i = sqrt(k_i) w_i the motion is u'' = -A u (`graph.motion`). Let p be a unit eigenvector of A,
and lambda its eigenvalue. This mode adds to w_i a sinusoid of the amplitude
abs(p_i)/sqrt(k_i) sqrt((p u)^2 + (p u')^2/lambda). In a symmetric graph several modes may have the same frequency, and
their eigenvectors are then arbitrary. Such modes form one sinusoid, so they are added before the root is taken.
Jacobi's method finds the eigenvectors. It rotates only pairs of contacts that are coupled.

**Saving work.** By Cauchy's inequality the sum of amplitudes is at most sqrt(2 E W_ii), where E is the energy of impact
and W the Delassus matrix. Eigenvectors are computed only where this bound allows a smaller margin.

Used by `graph.kernel`.
"""

from __future__ import annotations

from math import copysign, sqrt

from impact_xval.model.chain.grazing import EPSILON, first_turn, shift, write_slope
from impact_xval.model.chain.series import ORDER, slope, value
from impact_xval.model.compiled import kernel_helper
from impact_xval.model.graph.state import is_compliant
from impact_xval.model.pair.grazing import NEAR, STAKE

#: Largest number of sweeps of Jacobi's method over the matrix; about six sweeps are enough.
MOST_SWEEPS = 40

#: Largest difference between two eigenvalues that are taken as equal, as a share of the largest eigenvalue.
SAME = 1e-9


@kernel_helper
def near_misses(c, matrices, x, h, energy, margin):
    """Return the smaller one of `margin`, the grazing margin so far, and the smallest quotient within a window.

    The window has the length h, and is searched from its start to the time x h, at which the graph is. `energy` is the
    energy of impact.
    """
    for i in range(c.size):
        contact = c[i]
        if not is_compliant(contact.phase) or contact.e == 1:
            continue
        # Up to x the rate of this contact has one sign, so its force is largest at the start or at x.
        load = max(contact.forces[0], contact.F)
        least = 2 * contact.k * STAKE * energy / (1 - contact.e * contact.e)
        if load * load <= least:
            continue
        write_slope(contact.rates, ORDER, contact.turns)
        at = 0.0
        while True:
            to_turn = first_turn(contact.turns, ORDER, x - at)
            if not 0 < to_turn < x - at:
                break
            at += to_turn
            force = max(value(contact.forces, ORDER, at), 0.0)
            if force * force > least:
                rate = abs(value(contact.rates, ORDER, at))
                if rate < min(margin, NEAR) * sqrt(2 * energy * matrices.full[i, i]):
                    share = rate / amplitude(c, matrices, i, at, h)
                    margin = share if share < min(margin, NEAR) else margin
            shift(contact.turns, ORDER - 1, to_turn)
            contact.turns[0] = 0.0
    return margin


@kernel_helper
def amplitude(c, matrices, i, x, h):
    """Return the sum of the amplitudes of the sinusoids of which the rate of contact i consists, at the time x h."""
    A, vectors = matrices.A, matrices.vectors
    for a in range(c.size):
        for b in range(c.size):
            is_coupled = is_compliant(c[a].phase) and is_compliant(c[b].phase)
            A[a, b] = sqrt(c[a].k) * matrices.W[a, b] * sqrt(c[b].k) if is_coupled else 0.0
            vectors[a, b] = 1.0 if a == b else 0.0
    diagonalise(A, vectors)
    highest = 0.0
    for mode in range(c.size):
        highest = max(highest, A[mode, mode])
    total = 0.0
    for mode in range(c.size):
        is_new = A[mode, mode] > c.size * EPSILON * highest  # a mode of frequency 0 does not oscillate
        for before in range(mode):
            is_new &= abs(A[before, before] - A[mode, mode]) > SAME * highest
        if is_new:
            total += amplitude_of_frequency(c, matrices, i, mode, SAME * highest, x, h)
    return total / sqrt(c[i].k)


@kernel_helper
def amplitude_of_frequency(c, matrices, i, mode, distance, x, h):
    """Return the amplitude of one sinusoid in the rate of contact i, times sqrt(k_i).

    The sinusoid has the frequency of `mode`. It is the sum of all modes with this frequency. Eigenvalues that differ by
    at most `distance` belong to one frequency.
    """
    A, vectors = matrices.A, matrices.vectors
    by_rate, by_slope = 0.0, 0.0
    for same in range(mode, c.size):
        if abs(A[same, same] - A[mode, mode]) > distance:
            continue
        rate, turned = 0.0, 0.0
        for a in range(c.size):
            weight = vectors[a, same] * sqrt(c[a].k)
            rate += weight * value(c[a].rates, ORDER, x)
            turned += weight * slope(c[a].rates, ORDER, x) / h
        by_rate += vectors[i, same] * rate
        by_slope += vectors[i, same] * turned
    return sqrt(by_rate * by_rate + by_slope * by_slope / A[mode, mode])


@kernel_helper
def diagonalise(A, vectors):
    """Diagonalise a symmetric matrix A in place by Jacobi's rotations (Numerical Recipes, 11.1).

    The rotations are also applied to `vectors`. If it was the identity, its columns are then the eigenvectors.
    """
    for _ in range(MOST_SWEEPS):
        is_diagonal = True
        for p in range(A.shape[0]):
            for q in range(p + 1, A.shape[0]):
                beside = A[p, q]
                if beside * beside <= (EPSILON * EPSILON) * abs(A[p, p] * A[q, q]):
                    continue
                is_diagonal = False
                theta = 0.5 * (A[q, q] - A[p, p]) / beside
                t = copysign(1.0, theta) / (abs(theta) + sqrt(theta * theta + 1))
                c = 1 / sqrt(t * t + 1)
                s = t * c
                for j in range(A.shape[0]):
                    upper, lower = A[p, j], A[q, j]
                    A[p, j], A[q, j] = c * upper - s * lower, s * upper + c * lower
                for j in range(A.shape[0]):
                    upper, lower = A[j, p], A[j, q]
                    A[j, p], A[j, q] = c * upper - s * lower, s * upper + c * lower
                    upper, lower = vectors[j, p], vectors[j, q]
                    vectors[j, p], vectors[j, q] = c * upper - s * lower, s * upper + c * lower
                A[p, q] = A[q, p] = 0.0
        if is_diagonal:
            return
