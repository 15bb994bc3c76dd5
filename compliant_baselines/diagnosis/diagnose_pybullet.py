"""The traps of PyBullet, looked for in a client, or in a script up to its first step.

Each is shown by a test that sets it and measures what it does:

* ``unset-body``: a body without a stiffness adds a damping of 0.1 N s/m to a contact whose other body has one.
* ``no-stiffness``: neither body has one; the contact is rigid and perfectly plastic (or has the restitution).
* ``series``: both have one, and the contact is softer than either.
* ``slop``: forces begin `contactSlop` inside the surface (default 1e-5 m).
* ``restitution``: added to what a stiffness gives.
* ``long-step``: a step too long for the stiffest contact.

The engine does not tell a client its `contactSlop`, nor the contact parameters of a body in maximal coordinates
(``unreadable``): they are known where the calls that set them were seen.
"""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Generic, NamedTuple, TypeAlias, TypeVar

from impact_xval.compliant_baselines.contact.mapping import PYBULLET_RIGID, PybulletBody
from impact_xval.compliant_baselines.diagnosis.diagnosis import Finding, finding, long_step
from impact_xval.compliant_baselines.engines.packages import import_pybullet, standing_in

#: Engine's default of `contactSlop`, in m.
DEFAULT_SLOP = 1e-5

#: What a body without contact parameters counts as in a contact with one that has them (btManifoldResult.cpp).
UNSET = PybulletBody(PYBULLET_RIGID, 0.1)

#: Stiffness in N/m from which a body counts as rigid beside others.
RIGID = 1e15

#: Type of a body in maximal coordinates, in `getDynamicsInfo`.
MAXIMAL = 1

#: Diagonal in m up to which a box may be the margin of no shape: 1 mm to each side, and rounding.
_MARGIN = 4e-3

#: Pairs of bodies looked at, at most.
MOST_PAIRS = 100_000

#: What `changeDynamics` was given, by body and link.
Dynamics = Mapping[tuple[int, int], Mapping[str, Any]]

_Seen = TypeVar("_Seen")

#: Looks at a client: its id, what `setPhysicsEngineParameter` was given, what `changeDynamics` was given.
Look: TypeAlias = Callable[[int, dict[str, Any], Dynamics], _Seen]


class Link(NamedTuple):
    """A link that can touch.

    Name, mass in kg (0: fixed), restitution, contact parameters, height of the lowest point in m (fixed: -inf), number
    of its body and its own, whether it is in maximal coordinates.
    """

    name: str
    mass: float
    restitution: float
    contact: PybulletBody | None
    height: float
    body: int
    link: int
    maximal: bool


def diagnose_pybullet(
    client: int,
    engine_parameters: Mapping[str, Any] | None = None,
    dynamics: Dynamics | None = None,
    *,
    column: bool = False,
) -> list[Finding]:
    """Look for traps in a connected client.

    Parameters
    ----------
    client : int
        Id of the physics client.
    engine_parameters : mapping, optional
        What `setPhysicsEngineParameter` was given, if it is known; ``contactSlop`` cannot be asked for.
    dynamics : mapping, optional
        What `changeDynamics` was given for (body, link), if it is known; a body in maximal coordinates cannot be
        asked for it.
    column : bool
        Whether the bodies stand on one vertical line, so that only neighbours can touch.

    Returns
    -------
    list of Finding
        Empty if there are none.
    """
    import pybullet as p

    links, findings = links_of(client, dynamics)
    if column:
        links.sort(key=lambda link: link.height)
    settings = p.getPhysicsEngineParameters(physicsClientId=client)
    step = settings["fixedTimeStep"] / max(1, settings["numSubSteps"])
    pairs = itertools.pairwise(links) if column else itertools.combinations(links, 2)
    touching = [pair for pair in itertools.islice(pairs, MOST_PAIRS) if any(link.mass for link in pair)]
    for one, two in touching:
        findings += _of_pair(one, two, step)
    if any(link.contact for pair in touching for link in pair):
        known = engine_parameters is not None
        slop = (engine_parameters or {}).get("contactSlop", DEFAULT_SLOP)
        findings += [finding("slop", "contactSlop", slop=slop, known=known)] if slop > 0 else []
    return list(dict.fromkeys(findings))


def _of_pair(one: Link, two: Link, step: float) -> list[Finding]:
    where = f"{one.name} and {two.name}"
    if one.contact is None and two.contact is None:
        return [finding("no-stiffness", where)]
    findings = []
    pair = (one.contact or UNSET).against(two.contact or UNSET)
    if one.contact is None or two.contact is None:
        bare, other = (one, two) if one.contact is None else (two, one)
        findings.append(finding("unset-body", bare.name, other=other.name, damping=UNSET.damping))
    elif max(one.contact.stiffness, two.contact.stiffness) < RIGID:
        findings.append(finding("series", where, one=one.contact, two=two.contact, pair=pair))
    if one.restitution * two.restitution > 0:
        findings.append(finding("restitution", where, one=one.restitution, two=two.restitution))
    mass = 1 / sum(1 / link.mass for link in (one, two) if link.mass)
    return findings + long_step(where, (pair.stiffness / mass) ** 0.5, pair.damping / mass, step)


def links_of(client: int, dynamics: Dynamics | None) -> tuple[list[Link], list[Finding]]:
    """List every link that can touch, and those whose parameters cannot be read."""
    import pybullet as p

    links: list[Link] = []
    unreadable: list[Finding] = []
    at = {"physicsClientId": client}
    for body in (p.getBodyUniqueId(i, **at) for i in range(p.getNumBodies(**at))):
        name = p.getBodyInfo(body, **at)[1].decode()
        for link in range(-1, p.getNumJoints(body, **at)):
            info, (low, high) = p.getDynamicsInfo(body, link, **at), p.getAABB(body, link, **at)
            if low == high or _shapeless(p, client, body, link, math.dist(low, high), info[10] == MAXIMAL):
                continue
            words = f"body {body}" + (f" ({name})" if name else "") + (f" link {link}" if link >= 0 else "")
            mass, restitution, damping, stiffness = info[0], info[5], info[8], info[9]
            maximal = info[10] == MAXIMAL
            if maximal:  # the engine leaves these numbers as they were, whatever they were
                if dynamics is None:
                    unreadable.append(finding("unreadable", words))
                    continue
                known = dynamics.get((body, link), {})
                stiffness, damping = known.get("contactStiffness", -1.0), known.get("contactDamping", -1.0)
                restitution = known.get("restitution", 0.0)
            own = PybulletBody(stiffness, damping) if stiffness > 0 else None
            height = low[2] if mass else -math.inf
            links.append(Link(words, mass, restitution, own, height, body, link, maximal))
    return links, unreadable


def _shapeless(p: Any, client: int, body: int, link: int, size: float, maximal: bool) -> bool:
    """Tell whether a link has no collision shape though its box is not empty: that of a URDF is a margin then."""
    if maximal or size > _MARGIN:  # shapes of maximal bodies cannot be asked for
        return False
    return not p.getCollisionShapeData(body, link, physicsClientId=client)


class _Watching(Generic[_Seen]):
    """The module pybullet until the first step: notes engine parameters, opens no window."""

    def __init__(self, module: Any, look: Look[_Seen]) -> None:
        self._module, self._look = module, look
        self._parameters: dict[int, dict[str, Any]] = defaultdict(dict)
        self._dynamics: dict[int, dict[tuple[int, int], dict[str, Any]]] = defaultdict(dict)
        self.seen: _Seen | None = None
        self.failure: Exception | None = None
        self.stopped = False
        self.clients: list[int] = []

    def __getattr__(self, name: str) -> Any:
        return getattr(self._module, name)

    def connect(self, *args: Any, **kwargs: Any) -> int:
        self.clients.append(self._module.connect(self._module.DIRECT))
        return self.clients[-1]

    def setPhysicsEngineParameter(self, *args: Any, **kwargs: Any) -> Any:  # noqa: N802 (PyBullet's name)
        self._parameters[kwargs.get("physicsClientId", 0)].update(kwargs)
        return self._module.setPhysicsEngineParameter(*args, **kwargs)

    def setDefaultContactERP(self, *args: Any, **kwargs: Any) -> Any:  # noqa: N802
        value = args[0] if args else kwargs["defaultContactERP"]
        client = args[1] if len(args) > 1 else kwargs.get("physicsClientId", 0)
        self._parameters[client]["contactERP"] = value
        return self._module.setDefaultContactERP(*args, **kwargs)

    def changeDynamics(self, *args: Any, **kwargs: Any) -> Any:  # noqa: N802
        body = kwargs["bodyUniqueId"] if "bodyUniqueId" in kwargs else args[0]
        link = kwargs["linkIndex"] if "linkIndex" in kwargs else args[1]
        known = self._dynamics[kwargs.get("physicsClientId", 0)]
        known.setdefault((int(body), int(link)), {}).update(kwargs)
        return self._module.changeDynamics(*args, **kwargs)

    def stepSimulation(self, *args: Any, **kwargs: Any) -> None:  # noqa: N802
        client = args[0] if args else kwargs.get("physicsClientId", 0)
        try:
            self.seen = self._look(client, self._parameters[client], self._dynamics[client])
        except Exception as error:  # which the script is not to catch
            self.failure = error
        self.stopped = True
        raise SystemExit  # no `Exception`, which the script may catch; a thread ends by it without a word


def diagnose_at_first_step(run: Callable[[], object], *, column: bool = False) -> list[Finding] | None:
    """Run something that uses PyBullet up to its first step, and look for traps there.

    Parameters
    ----------
    run : callable
        As in `at_first_step`.
    column : bool
        As in `diagnose_pybullet`.

    Returns
    -------
    list of Finding or None
        None if it ended without a step.
    """
    return at_first_step(run, partial(diagnose_pybullet, column=column))


def at_first_step(run: Callable[[], object], look: Look[_Seen]) -> _Seen | None:
    """Run something that uses PyBullet up to its first step, and look at the client that was to step.

    Parameters
    ----------
    run : callable
        For example a script. It imports pybullet itself; windows it asks for are not opened, and clients it
        leaves connected are disconnected. What it raises
        before its first step is raised here.
    look : callable
        Given the client, and what `setPhysicsEngineParameter` and `changeDynamics` were given, as `diagnose_pybullet`
        has them.

    Returns
    -------
    object
        What `look` returned; None if it ended without a step. What `look` raises is raised.
    """
    pybullet = import_pybullet()
    watching = _Watching(pybullet, look)
    try:
        with standing_in("pybullet", watching):
            run()
    except SystemExit:
        if not watching.stopped:
            raise
    finally:
        for client in watching.clients:
            if pybullet.isConnected(client):
                pybullet.disconnect(client)
    if watching.failure is not None:
        raise watching.failure
    return watching.seen
