"""Closed forms of the limiting cases of two balls on a table, in which a contact is rigid, that is, infinitely stiff.

`rigid_contact` returns the contact that is treated as rigid. `runaway` computes the energy that a contact gives to the
other contact while its stiffness grows without bound in a finite time. `view_from` returns both contacts as the stiff
and the soft contact.

**Motion with a rigid contact.** In S1 a rigid contact does one of two things (`pair.lone`; docs/theory.md, section 4).
If it has enough energy to part its bodies, it completes its own impact at once, in no time for the soft contact.
Otherwise its bodies move as one body, and the soft contact works against this body until the end of the collision.
States S2 and S3 are the same as without a rigid contact.

A contact of finite stiffness needs some energy to pass on the force of the soft contact. This energy cannot part its
bodies, so it must be left out of the energy that is compared. Otherwise a collision whose stiffness ratio exceeds the
cut-off already at the first end of compression would lose all its restitution (docs/errata.md).

**Cases of the supplement.** The closed form covers four sections, which differ in the time at which it begins:

* 3.2: at first touch with k2/k1 = 0; equations (11)-(13), with the misprint in (13) corrected;
* 3.1: at first touch with k2/k1 = infinity; equation (6);
* 3.3: at the end of compression of a contact i with e_i = 0;
* 3.4: when the running stiffness ratio exceeds the cut-off.

If there is no cut-off, the closed form begins as soon as all that it neglects is negligible (`runaway`).

Units as in `pair.motion`: m1 = 1.

Used by `pair.kernel` and `pair.lone`. `model.solving` reports `BOUND`.
"""

from __future__ import annotations

from enum import IntEnum
from math import isnan, nan, pi, sqrt
from typing import NamedTuple

from impact_xval.model.compiled import force_inlined
from impact_xval.model.pair.law import Contact, Pair, Phase, with_energy
from impact_xval.model.pair.record import PairEnding

#: Largest error of (v1, v2) that `runaway` may cause, in the kinetic norm divided by sqrt(m1) abs(v0).
BOUND = 1e-12

#: Factor by which the estimated error of `runaway` is multiplied, for safety. Without it the error was at most 0.77 of
#: its estimate, in 360 000 collisions at each of the bounds 1e-6, 1e-8 and 1e-10 (docs/theory.md, section 4).
SAFETY = 2.0

#: Smallest distance of the soft contact's rate from zero, as a share of the amplitude of this rate, at which the
#: oscillations of the stiff contact need not be followed.
CLEAR = 1e-4

#: Value of the option `cutoff` that means: no cut-off. The closed form then begins when its error is below `BOUND`.
EXACT = 0.0

#: Ratio of the running stiffnesses of the stiff and the soft contact above which `runaway` is tried.
RUNAWAY_RATIO = 1e3


class Rigid(IntEnum):
    """Number of the contact that is treated as rigid, or none."""

    NONE = 0
    CONTACT1 = 1
    CONTACT2 = 2


class View(NamedTuple):
    """Both contacts of a pair, as the stiff contact and the soft contact, with the masses that they work against."""

    stiff: Contact
    soft: Contact
    #: Mass that the stiff contact works against.
    mass: float
    #: Rate of compression of the stiff contact.
    rate: float
    #: Mass that the soft contact works against if the bodies of the stiff contact move as one body.
    united_mass: float
    #: Rate of compression of the soft contact.
    soft_rate: float
    #: Share of the soft contact's force that the stiff contact passes on.
    share: float


@force_inlined
def view_from(stiff_is_1, pair, mu, M):
    """Return both contacts as stiff and soft contact. mu is m2/m1, and M is the reduced mass of both balls."""
    if stiff_is_1:
        return View(pair.contact1, pair.contact2, M, pair.d1, 1 + mu, -pair.v2, 1 / (1 + mu))
    return View(pair.contact2, pair.contact1, mu, -pair.v2, 1.0, pair.d1, 1.0)


@force_inlined
def rigid_contact(pair, mu, M, options, highest):
    """Return the contact that is treated as rigid from now on in S1, the ending that this implies, and the pair.

    A contact is rigid if the ratio of the running stiffnesses exceeds `highest`. If there is no cut-off, it is also
    rigid if `runaway` returns an energy. The soft contact of the returned pair has got this energy.
    """
    stiff_is_1 = pair.contact1.k > pair.contact2.k
    view = view_from(stiff_is_1, pair, mu, M)
    stiff, soft = view.stiff, view.soft
    rigid = Rigid.CONTACT1 if stiff_is_1 else Rigid.CONTACT2
    if soft.k < stiff.k / highest:
        return rigid, (PairEnding.CLOSED_FORM if highest == options.cutoff else PairEnding.PRECISION), pair
    has_just_ended_compression = view.rate == 0 and stiff.phase == Phase.RESTITUTION
    if options.cutoff != EXACT or not options.stiffens or not has_just_ended_compression:
        return Rigid.NONE, PairEnding.FINISHED, pair
    gain = nan
    if stiff.k > RUNAWAY_RATIO * soft.k:
        gain = runaway(view)
    if isnan(gain):
        return Rigid.NONE, PairEnding.FINISHED, pair
    loss = pair.loss + (stiff.E - gain)
    stiff, soft = with_energy(stiff, 0.0), with_energy(soft, soft.E + gain)
    contact1, contact2 = (stiff, soft) if stiff_is_1 else (soft, stiff)
    return rigid, PairEnding.CLOSED_FORM, Pair(pair.d1, pair.v2, contact1, contact2, loss)


@force_inlined
def runaway(view):
    """Return the energy that a stiff contact gives to the soft contact until it is rigid; NaN if this is uncertain.

    The stiff contact has just ended a compression. Its force oscillates about the static force F_s = share G that it
    passes on, where G is the force of the soft contact. Each further end of compression makes it stiffer, and after a
    finite time it is rigid. docs/theory.md, section 4, has the sum over all these events, and the terms that the sum
    neglects.

    The result is NaN if its error could change the outcome by more than `BOUND`. There are three reasons:

    - the neglected terms are too large;
    - the oscillation may carry the rate of the soft contact through zero, which would be an end of compression;
    - the stiffness does not grow without bound.
    """
    united, mass, share = view.united_mass, view.mass, view.share
    V, G, k_soft = view.soft_rate, view.soft.F, view.soft.k
    F, k, e = view.stiff.F, view.stiff.k, view.stiff.e
    F_s = share * G
    A = F - F_s
    period = 2 * pi * sqrt(mass / k)
    tau = period / (1 - e)
    slope = share * k_soft * V  # derivative of F_s in time
    drift = abs(slope) * tau
    swing = V * V + G * G / (k_soft * united)  # square of the amplitude of V
    wiggle = share * A / sqrt(k * mass)  # amplitude that the oscillation of the stiff contact gives V
    room = V - G * tau / united if V > 0 else -V
    # The rate of the stiff contact oscillates about slope/k with the amplitude A/sqrt(k mass). It has zeros if slope/k
    # is below the amplitude.
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
        # F_s falls below A in every oscillation. The bodies then part for an instant, and the contact becomes active
        # again with A = F_s.
        return F_s / k * (2 * above - slope * period * (0.5 + (2.5 + e * e + 0.5 * e * e * e) / cube))
    return nan
