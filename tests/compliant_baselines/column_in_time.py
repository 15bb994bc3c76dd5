"""An independent solution of the references for N balls: plain event-driven integration in time with scipy.

Shares nothing with the package but the parameters: the unknowns are heights and velocities of balls, the integrator is
DOP853, events are sign changes on its dense output.
"""

import numpy as np
from scipy.integrate import solve_ivp

#: Laws that tell compression from restitution.
TWO_PHASES = ("bistiffness", "compression-dashpot")


class _Contact:
    """A contact: its law, and the phase it is in ('' carries none, 'on', 'c'ompression, 'r'estitution)."""

    def __init__(self, law, p, k, e, b, gap):
        self.law, self.p, self.k, self.e, self.b = law, p, k, e, b
        self.surface, self.phase = gap, ""

    def depth(self, position):
        return position - self.surface

    def force(self, depth, rate):
        if not self.phase:
            return 0.0
        spring = self.k * max(depth, 0.0) ** self.p if self.p != 1 else self.k * depth
        if self.law == "kelvin-voigt" or (self.law == "compression-dashpot" and self.phase == "c"):
            return spring + self.b * max(depth, 0.0) ** ((self.p - 1) / 2) * rate
        return spring * (1 + self.b * rate) if self.law == "hunt-crossley" else spring

    def inside(self, depth, rate):
        """Positive while a dashpot's force is."""
        if self.law == "hunt-crossley":
            return 1 + self.b * rate
        return self.k * max(depth, 0.0) ** ((self.p + 1) / 2) + self.b * rate if self.b else depth

    def watched(self, slack, frozen):
        """What ends the phase: functions of depth and rate that fall through zero, with the phase after."""
        if frozen and not self.phase:
            return [(lambda d, w: -w, "c" if self.law in TWO_PHASES else "on")]
        if self.law in TWO_PHASES:
            if self.phase == "c":
                return [(lambda d, w: w, "r")]
            return [(lambda d, w: -w, "c"), (lambda d, w: d, "")] if self.phase else [(lambda d, w: -d, "c")]
        if self.phase:
            ends = [(self.inside, "")]
            return [*ends, (lambda d, w: d, "")] if self.law == "hunt-crossley" else ends
        if slack:
            return [(lambda d, w: -self.inside(d, w), "on"), (lambda d, w: d, "")]
        return [(lambda d, w: -d, "on")]


def integrate(column, law, p, b, rtol=1e-12, resolution=0.1, most=3000, frozen=False):
    """Final velocities of a column whose largest rate is 1.

    `b` holds c or a of each contact, in SI units. Where positions are frozen a contact without force begins anew, from
    no depth, where its bodies approach.
    """
    n, contacts = len(column.masses), len(column.stiffnesses)
    row = [
        _Contact(law, p, *given)
        for given in zip(column.stiffnesses, column.restitutions, b, column.gaps, strict=True)
    ]
    inverse = 1 / np.array(column.masses)
    bodies = np.append(inverse, 0.0) if column.table else inverse
    x, v = np.zeros(n), np.array(column.velocities)
    start = "c" if law in TWO_PHASES else "on"

    def relative(values):
        return np.diff(np.append(values, 0.0) if column.table else values)

    for order in (range(contacts), range(contacts - 1, -1, -1)):
        for i in order:
            closed, beside = column.gaps[i] == 0, i - 1 if order.step > 0 else i + 1
            pressed = 0 <= beside < contacts and row[beside].phase
            if closed and (relative(v)[i] > 0 or (relative(v)[i] == 0 and pressed)):
                row[i].phase = start
    slack = [False] * contacts
    for _ in range(most):
        on = [bool(c.phase) for c in row]
        if not any(on) and (relative(v) <= 0).all():
            return v
        watches = []
        for i, contact in enumerate(row):
            for f, after in contact.watched(slack[i], frozen):
                # A contact that its neighbours have hardly pressed yet has a rate and a force of either sign.
                quiet = 1e-13 if contact.phase in ("on", "c") else 0.0

                def event(_t, y, i=i, f=f, contact=contact, quiet=quiet):
                    d = contact.depth(relative(y[:n])[i])
                    return f(d, relative(y[n:])[i]) + quiet * (d < 1e-13)

                event.terminal, event.direction = True, -1
                watches.append((i, after, f, event))

        def rhs(_t, y):
            d, w = relative(y[:n]), relative(y[n:])
            forces = np.zeros(n + 1)
            for i, c in enumerate(row):
                forces[i + 1] = c.force(c.depth(d[i]), w[i])
            return np.concatenate([y[n:], inverse * (forces[1:] - forces[:-1])])

        stiff = max(
            [
                (bodies[i] + bodies[i + 1])
                * (c.k * p * (1.0 if p == 1 else max(c.depth(relative(x)[i]), 0.3) ** (p - 1)))
                for i, c in enumerate(row)
                if c.phase
            ],
            default=0.0,
        )
        step = resolution / np.sqrt(stiff) if stiff else 1.0
        done = solve_ivp(
            rhs, (0, 1e5 * step), np.concatenate([x, v]), method="DOP853", rtol=rtol, atol=1e-14,
            events=[event for *_, event in watches], max_step=step if stiff else np.inf, first_step=1e-3 * step,
        )  # fmt: skip
        assert done.success, done.message
        x, v = done.y[:n, -1], done.y[n:, -1]
        hit = [(t[0], w) for t, w in zip(done.t_events, watches, strict=True) if t.size]
        if not hit:
            continue
        _, (i, after, _, _) = min(hit, key=lambda entry: entry[0])
        contact, depth = row[i], row[i].depth(relative(x)[i])
        if law == "bistiffness":
            if contact.phase == "c" and after == "r":
                contact.k /= contact.e ** (2 * p)
                contact.surface += (1 - contact.e**2) * depth
        elif law not in TWO_PHASES:  # else no contact is slack
            slack[i] = bool(contact.phase) and not after and depth > 1e-12
        if frozen and not contact.phase:
            contact.surface += depth
        contact.phase = after
    raise AssertionError(f"not over after {most} events")
