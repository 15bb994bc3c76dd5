"""Closed forms of the limiting cases, as motion inside S1.

A contact that is infinitely stiff does one of two things in S1 (`pair.kernel.at_work`; docs/theory.md, section 4).
While it still holds energy that can part its bodies, it completes its own impact at once, the soft contact standing
still meanwhile. Once it holds none, its bodies are one and the soft contact works against them as such, to the end of
the collision. States S2 and S3 need nothing new.

At a finite ratio a stiff contact holds some energy merely by passing on the soft contact's force, and that energy
cannot part its bodies. Without this distinction a collision whose ratio leaves the cut-off at the very first end of
compression would lose all its restitution (docs/errata.md).

Started from the beginning of the collision this is the supplement's section 3.2 (k2/k1 = 0; its (11)-(13), (13)
without the misprint) and 3.1 (k2/k1 = infinity; (6)); where contact i ends compression with e_i = 0 it is 3.3; from
the state at hand when the running stiffness ratio leaves the cut-off it is 3.4.
Without a cut-off the closed form is taken when nothing that it leaves out matters any more (`runaway`).

Units as in `pair.motion`; m1 = 1.
"""

from __future__ import annotations

from math import nan, pi, sqrt

from impact_xval.model.compiled import inlined

#: What `runaway` may change in (v1, v2), in the kinetic norm per sqrt(m1) abs(v0).
BOUND = 1e-12

#: Without this factor the error of `runaway` was at most 0.77 of its estimate, over 360 000 cells at each of the bounds
#: 1e-6, 1e-8 and 1e-10 (docs/theory.md, section 4).
SAFETY = 2.0

#: How far from zero, relative to its amplitude, the rate of the soft contact stays while the stiff one rings unwatched.
CLEAR = 1e-4


@inlined
def runaway(united, mass, share, V, G, k_soft, F, k, e):
    """Tell what a stiff contact does to the soft one's energy until it is rigid, if that is all it can do.

    The stiff contact has just ended a compression, and rings about the static force F_s = share G that it passes on;
    docs/theory.md, section 4, has the sum over all of its ends of compression, and what that leaves out. `united` is
    the mass of its bodies as one, `mass` that which it works against; V, G and k_soft are compression rate, force and
    stiffness of the soft contact; F, k and e force, stiffness and restitution of the stiff one.

    Gives what to add to the energy of the soft contact before the bodies go on as one. NaN if the stiff contact could
    still change more than `BOUND`: by what the sum leaves out, by carrying the rate of the soft contact through zero,
    which decides on an end of compression, or by not running away.
    """
    F_s = share * G
    A = F - F_s
    period = 2 * pi * sqrt(mass / k)
    tau = period / (1 - e)
    slope = share * k_soft * V  # of F_s
    drift = abs(slope) * tau
    swing = V * V + G * G / (k_soft * united)  # square of the amplitude of V
    wiggle = share * A / sqrt(k * mass)  # what the ringing adds to V
    room = V - G * tau / united if V > 0 else -V
    # The rate rings about slope/k with an amplitude of A/sqrt(k mass); it has zeros while their ratio is below 1.
    ratio2 = slope * slope * mass / (k * A * A)
    clear = A > 0 and F_s > 0 and ratio2 < 0.25 and room > 2 * wiggle + CLEAR * sqrt(swing)
    if not clear or (slope < 0 and drift > 0.1 * F_s):
        return nan
    above = max(0.0, A - F_s)
    bend = k_soft * tau * tau / united + share * share * k_soft / k
    error = SAFETY * (drift * drift + above * above + F_s * F_s * bend + F_s * A * ratio2) / k
    if error * error > BOUND * BOUND * united * swing:
        return nan
    cube = 1 - e * e * e
    lowest = F_s - drift if slope < 0 else F_s
    if lowest >= A:
        return -F * slope * period / (cube * k)
    if 0 <= A - F_s <= -slope * period / e:
        # F_s falls below A in every turn: the bodies part for an instant, and the contact returns with A = F_s.
        return F_s / k * (2 * above - slope * period * (0.5 + (2.5 + e * e + 0.5 * e * e * e) / cube))
    return nan
