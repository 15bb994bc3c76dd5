"""Closed forms of the limiting cases, as motion inside S1: which contact is rigid, and its effect on the other one.

`rigid_contact` decides which contact counts as rigid. `runaway` computes the effect of a contact whose stiffness runs
away, up to the time at which it is rigid. `view_from` tells the stiff contact from the soft contact.

An infinitely stiff contact does one of two things in S1 (`pair.lone`; docs/theory.md, section 4). While it holds energy
that can part its bodies, it completes its own impact at once, and the soft contact stands still meanwhile. Without such
energy its bodies are one, and the soft contact works against this one body to the end of the collision. States S2 and
S3 are the same as without a rigid contact.

At a finite ratio a stiff contact holds some energy only because it passes on the soft contact's force. That energy
cannot part its bodies. Without this distinction, a collision whose ratio exceeds the cut-off at the very first end of
compression would lose all its restitution (docs/errata.md).

The closed form covers these sections of the supplement:

* 3.2, if it begins at first touch with k2/k1 = 0: equations (11)-(13), with the misprint in (13) corrected;
* 3.1, if it begins at first touch with k2/k1 = infinity: equation (6);
* 3.3, if it begins where contact i ends compression with e_i = 0;
* 3.4, if it begins where the running stiffness ratio exceeds the cut-off.

Without a cut-off the closed form begins as soon as everything that it neglects is negligible (`runaway`).

Units as in `pair.motion`; m1 = 1. Used by `pair.kernel` and `pair.lone`; `model.solving` states `BOUND`.
"""

from __future__ import annotations

from enum import IntEnum
from math import isnan, nan, pi, sqrt
from typing import NamedTuple

from impact_xval.model.compiled import force_inlined
from impact_xval.model.pair.law import Contact, Pair, Phase, with_energy
from impact_xval.model.pair.record import PairEnding

#: Largest change of (v1, v2) that `runaway` may cause, in the kinetic norm per sqrt(m1) abs(v0).
BOUND = 1e-12

#: Factor on the estimated error of `runaway`. Without the factor the error was at most 0.77 of its estimate, in 360 000
#: cells at each of the bounds 1e-6, 1e-8 and 1e-10 (docs/theory.md, section 4).
SAFETY = 2.0

#: Least distance from zero of the soft contact's rate, relative to its amplitude, while the stiff contact rings
#: unwatched.
CLEAR = 1e-4

#: Value of the option `cutoff` without a cut-off: the closed form begins when it changes less than `BOUND`.
EXACT = 0.0

#: Running stiffness ratio above which `runaway` is tried.
RUNAWAY_RATIO = 1e3


class Rigid(IntEnum):
    """The contact that counts as rigid."""

    NONE = 0
    CONTACT1 = 1
    CONTACT2 = 2


class View(NamedTuple):
    """Both contacts, told apart as the stiff contact and the soft contact."""

    stiff: Contact
    soft: Contact
    #: Mass that the stiff contact works against; compression rate of the stiff contact.
    mass: float
    rate: float
    #: Mass that the soft contact works against if the bodies of the stiff contact are one; compression rate of the soft
    #: contact.
    united_mass: float
    soft_rate: float
    #: Share of the soft contact's force that the stiff one passes on.
    share: float


@force_inlined
def view_from(stiff_is_1, pair, mu, M):
    """Return the view in which contact 1 or contact 2 is the stiff one, at mass ratio mu and reduced mass M."""
    if stiff_is_1:
        return View(pair.contact1, pair.contact2, M, pair.d1, 1 + mu, -pair.v2, 1 / (1 + mu))
    return View(pair.contact2, pair.contact1, mu, -pair.v2, 1.0, pair.d1, 1.0)


@force_inlined
def rigid_contact(pair, mu, M, options, highest):
    """Return the contact that counts as rigid from here on in S1, the ending that this implies, and the pair.

    A contact is rigid if the running stiffness ratio exceeds `highest`. Without a cut-off it is rigid too if its
    stiffness runs away and `runaway` gives its effect; the energy that `runaway` returns goes to the soft contact.
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
    """Return the energy that a stiff contact adds to the soft contact until it is rigid; NaN where this is uncertain.

    The stiff contact has just ended a compression, and rings about the static force F_s = share G that it passes on,
    where G is the force of the soft contact. docs/theory.md, section 4, has the sum over all further ends of
    compression, and the terms that this sum neglects. Afterwards the bodies of the stiff contact are one.

    The result is NaN if the stiff contact could change the outcome by more than `BOUND`. There are three reasons: the
    neglected terms are too large; the ringing may carry the rate of the soft contact through zero, which would be an
    end of compression; or the stiffness does not run away.
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
    wiggle = share * A / sqrt(k * mass)  # amplitude that the ringing gives V
    room = V - G * tau / united if V > 0 else -V
    # The rate of the stiff contact rings about slope/k with the amplitude A/sqrt(k mass). It has zeros if slope/k is
    # below the amplitude.
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
        # F_s falls below A in every oscillation. The bodies part for an instant, and the contact returns with A = F_s.
        return F_s / k * (2 * above - slope * period * (0.5 + (2.5 + e * e + 0.5 * e * e * e) / cube))
    return nan
