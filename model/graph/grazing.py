"""The grazing margin of a graph: turning points of the rates of active contacts, over their amplitudes.

docs/theory.md, section 6, defines it: the smallest abs(w_i) at a turning point, w_i' = 0, over the sum of the
amplitudes of the sinusoids of w_i at that time. A turning point counts if this quotient is below `NEAR`, and if an end
of compression there would lose at least the share `STAKE` of the energy of impact.

With u_i = sqrt(k_i) w_i the motion is u'' = -A u (`graph.motion`). A unit eigenvector p of A with the eigenvalue lambda
adds to w_i a sinusoid of the amplitude abs(p_i)/sqrt(k_i) sqrt((p u)^2 + (p u')^2/lambda). In a symmetric graph several
modes have one frequency, and their eigenvectors are arbitrary. Such modes form one sinusoid, so they are added before
the root is taken. Jacobi's method finds the eigenvectors; it rotates only contacts that are coupled.

By Cauchy's inequality the sum of amplitudes is at most sqrt(2 E W_ii), where E is the energy of impact. Eigenvectors
are computed only where this bound allows a smaller margin.

Used by `graph.kernel`.
"""

from __future__ import annotations

from math import copysign, sqrt

from impact_xval.model.chain.grazing import EPSILON, first_turn, shift, write_slope
from impact_xval.model.chain.series import ORDER, slope, value
from impact_xval.model.compiled import kernel_helper
from impact_xval.model.graph.state import is_compliant
from impact_xval.model.pair.grazing import NEAR, STAKE

#: Largest number of sweeps of Jacobi's method; some six suffice.
MOST_SWEEPS = 40

#: Largest difference of two eigenvalues that count as equal, over the largest eigenvalue.
SAME = 1e-9


@kernel_helper
def near_misses(c, matrices, x, h, energy, margin):
    """Return the grazing margin after the first part x of a window of length h, given the margin before the window.

    The graph is at the end of that part; `energy` is the energy of impact.
    """
    for i in range(c.size):
        contact = c[i]
        if not is_compliant(contact.phase) or contact.e == 1:
            continue
        # The rate has one sign in a window, so the load is largest at one of its ends.
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
    """Return the sum of the amplitudes of the sinusoids of contact i's rate, at the place x of a window of length h."""
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
        is_new = A[mode, mode] > c.size * EPSILON * highest  # else no such mode is in the motion
        for before in range(mode):
            is_new &= abs(A[before, before] - A[mode, mode]) > SAME * highest
        if is_new:
            total += amplitude_of_frequency(c, matrices, i, mode, SAME * highest, x, h)
    return total / sqrt(c[i].k)


@kernel_helper
def amplitude_of_frequency(c, matrices, i, mode, distance, x, h):
    """Return sqrt(k_i) times the amplitude, in the rate of contact i, of all modes with the frequency of `mode`."""
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
    """Diagonalise a symmetric matrix by Jacobi's rotations, and apply them to `vectors` (Numerical Recipes, 11.1)."""
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
