"""Closed forms of the limiting cases, as motion inside S1.

They rest on the supplement's hypothesis: if one contact is infinitely stiffer than the other, its two bodies act as
one once they reach the same velocity, and the rest of the collision is a single impact with the third body.

A contact that is infinitely stiff therefore does one of two things in S1. While it still holds energy that can part
its bodies, it completes its own impact at once, the soft contact standing still meanwhile (`complete_ball_ball`,
`complete_ball_table`). Once it holds none, its bodies are one and the soft contact works against them as such, to the
end of the collision (`one_body`, `part_of_table`). States S2 and S3 need nothing new.

At a finite ratio a stiff contact holds some energy merely by passing on the soft contact's force, and that energy
cannot part its bodies: about the static force F_s the stiff contact oscillates, and F falls to zero with the relative
speed s where M s^2/2 = M d^2/2 + E - F F_s/k. The last term is `static_energy1`, `static_energy2`. Where what is left
would part the bodies at less than |v0|/sqrt(cutoff), they are taken as one. Without this distinction a collision whose
ratio leaves the cut-off at the very first end of compression would lose all its restitution (docs/errata.md).

Started from the beginning of the collision this is the supplement's section 3.2 (k2/k1 = 0; its (11)-(13), (13)
without the misprint) and 3.1 (k2/k1 = infinity; (6)); where contact i ends compression with e_i = 0 it is 3.3; from
the state at hand when the running stiffness ratio leaves the cut-off it is 3.4.

Units as in `model.motion`; m1 = 1.
"""

from __future__ import annotations

from math import inf, sqrt

from model.compiled import compiled
from model.motion import single_contact


@compiled
def static_energy1(mu, E1, E2, k1, k2):
    """F1 F_s/k1 of the ball-ball contact under the static force F_s = F2 m1/(m1 + m2) that B1 as a rider needs."""
    return 2 * sqrt(E1 * E2 * (k2 / k1)) / (1 + mu)


@compiled
def static_energy2(E1, E2, k1, k2):
    """F2 F_s/k2 of the ball-table contact under the static force F_s = F1 that B2 passes on to the table."""
    return 2 * sqrt(E1 * E2 * (k1 / k2))


@compiled
def complete_ball_ball(mu, d1, v2, E1, e1, compressing1):
    """Run the stiff ball-ball contact through its impact; B1 and B2 are as free.

    Returns
    -------
    d1, v2 : float
        Compression rate and velocity of B2 after it; E1 is then zero (supplement (11), (12)).
    """
    _, _, impulse, d1, _ = single_contact(mu / (1 + mu), d1, E1, e1, compressing1, inf)
    return d1, v2 - impulse / mu


@compiled
def complete_ball_table(mu, v2, E2, e2, compressing2):
    """Run the stiff ball-table contact through its impact, B2 as free; return the velocity of B2 after it."""
    _, _, _, d2, _ = single_contact(mu, -v2, E2, e2, compressing2, inf)
    return -d2


@compiled
def one_body(mu, v, E2, e2, compressing2):
    """Both balls, moving as one with v, finish against the table: their final velocity (supplement, 3.3, S1)."""
    _, _, _, d2, _ = single_contact(1 + mu, -v, E2, e2, compressing2, inf)
    return -d2


@compiled
def part_of_table(v1, E1, e1, compressing1):
    """B1 finishes against B2, which rests on the table: its final velocity (supplement, 3.3)."""
    _, _, _, d1, _ = single_contact(1.0, -v1, E1, e1, compressing1, inf)
    return -d1
