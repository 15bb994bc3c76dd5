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
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from impact_xval.compliant_baselines.contact.mapping import PYBULLET_RIGID, PybulletBody
from impact_xval.compliant_baselines.diagnosis.diagnosis import Finding, step_finding
from impact_xval.compliant_baselines.engines.packages import standing_in

#: Engine's default of `contactSlop`, in m.
DEFAULT_SLOP = 1e-5

#: What a body without contact parameters counts as in a contact with one that has them (btManifoldResult.cpp).
UNSET = PybulletBody(PYBULLET_RIGID, 0.1)

#: Stiffness in N/m from which a body counts as rigid beside others.
RIGID = 1e15

#: Type of a body in maximal coordinates, in `getDynamicsInfo`.
MAXIMAL = 1

#: Pairs of bodies looked at, at most.
MOST_PAIRS = 100_000


def diagnose_pybullet(
    client: int,
    engine_parameters: Mapping[str, Any] | None = None,
    dynamics: Mapping[tuple[int, int], Mapping[str, Any]] | None = None,
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

    links, findings = _links(p, client, dynamics)
    if column:
        links.sort(key=lambda link: link.height)
    settings = p.getPhysicsEngineParameters(physicsClientId=client)
    step = settings["fixedTimeStep"] / max(1, settings["numSubSteps"])
    stiff = False
    pairs = itertools.pairwise(links) if column else itertools.combinations(links, 2)
    for (name1, m1, e1, one, _), (name2, m2, e2, two, _) in itertools.islice(pairs, MOST_PAIRS):
        if m1 == 0 and m2 == 0:
            continue
        where = f"{name1} and {name2}"
        if one is None and two is None:
            findings.append(
                Finding(
                    "no-stiffness",
                    where,
                    "neither has a contactStiffness: the contact is rigid, with no duration",
                )
            )
            continue
        stiff = True
        if one is None or two is None:
            bare = name1 if one is None else name2
            findings.append(
                Finding(
                    "unset-body",
                    bare,
                    f"it has no contactStiffness, but {name2 if one is None else name1} has: it adds a damping of "
                    f"{UNSET.damping} N s/m to their contact; set contactStiffness=1e30, contactDamping=0",
                )
            )
        pair = (one or UNSET).against(two or UNSET)
        if one is not None and two is not None and max(one.stiffness, two.stiffness) < RIGID:
            findings.append(
                Finding(
                    "series",
                    where,
                    f"{one.stiffness:g} and {two.stiffness:g} N/m in series are {pair.stiffness:g} N/m, and "
                    f"dampings add to {pair.damping:g} N s/m, if these two touch; give one contactStiffness=1e30, "
                    "contactDamping=0",
                )
            )
        if e1 * e2 > 0:
            findings.append(
                Finding(
                    "restitution",
                    where,
                    f"restitution {e1:g} times {e2:g} acts beside the stiffness; set it to 0",
                )
            )
        mass = 1 / ((1 / m1 if m1 else 0.0) + (1 / m2 if m2 else 0.0))
        long = step_finding(where, (pair.stiffness / mass) ** 0.5, pair.damping / mass, step)
        findings += [long] if long else []
    if stiff:
        findings += _slop(engine_parameters)
    return list(dict.fromkeys(findings))


def _slop(parameters: Mapping[str, Any] | None) -> list[Finding]:
    if parameters is None:
        says = f"cannot be read from a client; unless it was set to 0, forces begin {DEFAULT_SLOP:g} m inside a surface"
        return [Finding("slop", "contactSlop", says)]
    slop = parameters.get("contactSlop", DEFAULT_SLOP)
    if slop <= 0:
        return []
    says = f"forces begin {slop:g} m inside a surface; set setPhysicsEngineParameter(contactSlop=0)"
    return [Finding("slop", "contactSlop", says)]


def _links(
    p: Any, client: int, dynamics: Mapping[tuple[int, int], Mapping[str, Any]] | None
) -> tuple[list[_Link], list[Finding]]:
    """List every link that can touch, and those that do not tell enough."""
    links: list[_Link] = []
    unreadable: list[Finding] = []
    for i in range(p.getNumBodies(physicsClientId=client)):
        body = p.getBodyUniqueId(i, physicsClientId=client)
        _, name = p.getBodyInfo(body, physicsClientId=client)
        for link in range(-1, p.getNumJoints(body, physicsClientId=client)):
            # A link without a collision shape has an empty box; the shapes of maximal bodies cannot be asked for.
            low, high = p.getAABB(body, link, physicsClientId=client)
            if low == high:
                continue
            info = p.getDynamicsInfo(body, link, physicsClientId=client)
            words = f"body {body}" + (f" ({name.decode()})" if name else "")
            if link >= 0:
                words += f" link {link}"
            stiffness, damping, restitution = info[9], info[8], info[5]
            if info[10] == MAXIMAL:  # the engine leaves these numbers as they were, whatever they were
                known = (dynamics or {}).get((body, link), {})
                stiffness, damping = known.get("contactStiffness", -1.0), known.get("contactDamping", -1.0)
                restitution = known.get("restitution", 0.0)
                if dynamics is None:
                    says = "a body in maximal coordinates does not tell its contactStiffness: left out"
                    unreadable.append(Finding("unreadable", words, says))
                    continue
            own = PybulletBody(stiffness, damping) if stiffness > 0 else None
            links.append(_Link(words, info[0], restitution, own, -math.inf if info[0] == 0 else low[2]))
    return links, unreadable


class _Link(NamedTuple):
    """Name, mass in kg (0: fixed), restitution, contact parameters, height of the lowest point in m (fixed: -inf)."""

    name: str
    mass: float
    restitution: float
    contact: PybulletBody | None
    height: float


class _Stopped(BaseException):
    """Ends a script at its first step; not an `Exception`, so that the script does not catch it."""


class _Watching:
    """The module pybullet until the first step: notes engine parameters, opens no window."""

    def __init__(self, module: Any, column: bool) -> None:
        self._module, self._column = module, column
        self.parameters: dict[int, dict[str, Any]] = {}
        self.dynamics: dict[int, dict[tuple[int, int], dict[str, Any]]] = {}
        self.findings: list[Finding] | None = None
        self.clients: list[int] = []

    def __getattr__(self, name: str) -> Any:
        return {
            "connect": self._connect,
            "setPhysicsEngineParameter": self._set_parameter,
            "changeDynamics": self._change_dynamics,
            "stepSimulation": self._step,
        }.get(name, getattr(self._module, name))

    def _connect(self, *args: Any, **kwargs: Any) -> int:
        self.clients.append(self._module.connect(self._module.DIRECT))
        return self.clients[-1]

    def _set_parameter(self, *args: Any, **kwargs: Any) -> Any:
        self.parameters.setdefault(kwargs.get("physicsClientId", 0), {}).update(kwargs)
        return self._module.setPhysicsEngineParameter(*args, **kwargs)

    def _change_dynamics(self, *args: Any, **kwargs: Any) -> Any:
        body = kwargs["bodyUniqueId"] if "bodyUniqueId" in kwargs else args[0]
        link = kwargs["linkIndex"] if "linkIndex" in kwargs else args[1]
        known = self.dynamics.setdefault(kwargs.get("physicsClientId", 0), {}).setdefault(
            (int(body), int(link)), {}
        )
        known.update(kwargs)
        return self._module.changeDynamics(*args, **kwargs)

    def _step(self, *args: Any, **kwargs: Any) -> None:
        client = args[0] if args else kwargs.get("physicsClientId", 0)
        self.findings = diagnose_pybullet(
            client, self.parameters.get(client, {}), self.dynamics.get(client, {}), column=self._column
        )
        raise _Stopped


def diagnose_at_first_step(run: Callable[[], object], *, column: bool = False) -> list[Finding] | None:
    """Run something that uses PyBullet up to its first step, and look for traps there.

    Parameters
    ----------
    run : callable
        For example a script. It imports pybullet itself; windows it asks for are not opened, and clients it
        leaves connected are disconnected. What it raises
        before its first step is raised here.
    column : bool
        As in `diagnose_pybullet`.

    Returns
    -------
    list of Finding or None
        None if it ended without a step.
    """
    import pybullet

    watching = _Watching(pybullet, column)
    try:
        with standing_in("pybullet", watching):
            run()
    except _Stopped:
        pass
    finally:
        for client in watching.clients:
            if pybullet.isConnected(client):
                pybullet.disconnect(client)
    return watching.findings
