"""Exudyn: mass points in a line with `ObjectContactSphereSphere`, solved by the engine's implicit solver.

**Laws.** With `impactModel` 0 a contact has F = k delta + c delta' while spheres overlap. The contact may pull. So its
law is `linear-dashpot`. With models 1 and 2 it has F = k delta (1 + a delta'), damped in proportion to the depth. These
models compute a from the restitution e and from the speed u at which *this* contact begins (the engine's
ObjectContactSphereSphere.rst). The exact solver `hunt-crossley` uses one speed for all contacts. So it does not solve
these two models, and no other exact solver does.

* Model 1 has a = 3 (1 - e)/(2 u), after Hunt and Crossley. Its restitution is larger than e.
* Model 2 has a = 3 (1 - e) (11 - e)/(2 (1 + 9 e) u), after Carvalho and Martins, and a = (1 - e^2)/(e u) for e of at
  most 1/3, after Gonthier and others. The restitution of a contact alone is within some 1e-3 of e.

If bodies touch and are at rest, the speed at which their contact begins goes to zero with the step, and the damping
grows beyond all bounds. So in models 1 and 2 a ball that rests on the table stays there when it is struck.

**Integration** is by Newmark's method, the trapezoidal rule. The engine's default is the generalised alpha method,
whose acceleration follows the force with a delay: after every step 0.73 of the difference is left, with opposite sign.
So velocities still change for some 20 steps after bodies have parted, as if the contact were active. In a drop gravity
would also end some 20 steps late.

**Bodies.** The table is a fixed sphere with the radius of the balls. Along one line it acts as a plane would.

**Units** are the radius, the mass of ball 1, and the shortest contact period over 2 pi. They are needed because the
engine's tolerances are absolute: they do not scale with the motion.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from importlib import import_module
from types import ModuleType
from typing import Protocol

import numpy as np

from impact_xval.compliant_baselines.engines.engine import Engine
from impact_xval.compliant_baselines.engines.scene import Floats, Scene, World, periods
from impact_xval.compliant_baselines.mapping import KelvinVoigtContact

#: Largest error of a force with which a step is accepted after a contact began or ended in it. The unit is the force of
#: a unit stiffness at a unit length.
CONTACT_TOLERANCE = 1e-9

#: Gap of an open contact before the start, in the unit of the engine's contact data. If it is not set, the contact gets
#: no initial speed.
OPEN = 1.0


class ExudynSystemData(Protocol):
    """The methods of `exudyn.SystemData` that the adapter calls; coordinates have the shape (3 N,)."""

    def SetDataCoordinates(self, coordinates: Floats, *, configuration: object) -> None:
        """Write the engine's data of all contacts, shape (4 C,)."""
        ...

    def SetODE2Coordinates(self, coordinates: Floats, *, configuration: object) -> None:
        """Write the coordinates of all balls, shape (3 N,)."""
        ...

    def SetODE2Coordinates_t(self, coordinates: Floats, *, configuration: object) -> None:
        """Write the velocities of all balls, shape (3 N,)."""
        ...


class ExudynIntegration(Protocol):
    """The members of `exudyn.TimeIntegrationSettings` that the adapter writes before every run."""

    numberOfSteps: int
    endTime: float


class ExudynSettings(Protocol):
    """The member of `exudyn.SimulationSettings` that the adapter changes before every run."""

    timeIntegration: ExudynIntegration


class ExudynSystem(Protocol):
    """The members of `exudyn.MainSystem` that the adapter calls.

    Each `Add` method returns an object that names the added item in later calls.
    """

    systemData: ExudynSystemData

    def AddNode(self, item: object) -> object:
        """Add a node, which holds coordinates."""
        ...

    def AddObject(self, item: object) -> object:
        """Add a body, a ground or a contact."""
        ...

    def AddLoad(self, item: object) -> object:
        """Add a load, such as a weight."""
        ...

    def AddMarker(self, item: object) -> object:
        """Add a marker, to which loads and contacts are attached."""
        ...

    def AddSensor(self, item: object) -> object:
        """Add a sensor, which records a quantity of a node."""
        ...

    def Assemble(self) -> None:
        """Finish the system; nothing can be added afterwards."""
        ...

    def GetObjectParameter(self, item: object, name: str) -> float:
        """Return a parameter of an object."""
        ...

    def GetSensorStoredData(self, item: object) -> Floats:
        """Return what a sensor has recorded: a row for every step, with the time and three components."""
        ...

    def SetLoadParameter(self, item: object, name: str, value: Sequence[float]) -> bool:
        """Change a parameter of a load."""
        ...

    def SolveDynamic(self, settings: ExudynSettings, *, updateInitialValues: bool, showHints: bool) -> bool:
        """Take the steps in `settings`, and return True if the solver succeeded."""
        ...


class ExudynWorld(World):
    """A scene in its own system of Exudyn."""

    #: Largest relative error of a momentum: the engine's Newton method stops at some 1e-10 of a force.
    rounding = 2.0**-30
    #: The trapezoidal rule gives half of the force at the end of a step to this step.
    first_step_share = 0.5

    def __init__(self, scene: Scene, radius: float, model: int) -> None:
        super().__init__(scene, radius, scene.masses[-1] * scene.gravity / scene.stiffnesses[-1])
        exudyn = import_module("exudyn")
        self.pulls = model == 0
        self._length, mass, time = radius, scene.masses[0], min(periods(scene)) / (2 * math.pi)
        self._speed, self._step = radius / time, scene.step / time
        self._has_table = scene.table
        self._container = exudyn.SystemContainer()
        self._system: ExudynSystem = self._container.AddSystem()
        self._nodes, self._loads, contacts = _build(self._system, scene, model, mass, time, radius)
        output = exudyn.OutputVariableType
        items = import_module("exudyn.itemInterface")
        self._sensors = [
            self._system.AddSensor(
                items.SensorNode(nodeNumber=node, storeInternal=True, outputVariableType=quantity)
            )
            for quantity in (output.Velocity, output.Displacement)
            for node in self._nodes
        ]
        self._system.Assemble()
        self._settings = _settings(exudyn)
        self._write_state(np.array(scene.velocities), self.heights)
        stiffnesses = [
            self._system.GetObjectParameter(contact, "contactStiffness") * mass / time**2
            for contact in contacts
        ]
        self.effective = {
            "stiffness": tuple(
                # The conversion to the engine's units may have changed the last bits.
                k if math.isclose(stiffness, k, rel_tol=1e-14) else stiffness
                for stiffness, k in zip(stiffnesses, scene.stiffnesses, strict=True)
            )
        }

    def _write_state(self, velocities: Floats, heights: Floats) -> None:
        """Set the state from which the next steps start: velocities in m/s and heights in m, shape (N,).

        Contacts whose bodies overlap are entered as closed before the start, and all other contacts as open.
        """
        data = self._system.systemData
        initial = import_module("exudyn").ConfigurationType.Initial
        for write, values in (
            (data.SetODE2Coordinates, heights / self._length),
            (data.SetODE2Coordinates_t, velocities / self._speed),
        ):
            coordinates = np.zeros((len(values), 3))
            coordinates[:, 2] = values
            write(coordinates.ravel(), configuration=initial)
        gaps = -np.diff([*heights, *([0.0] if self._has_table else [])]) / self._length
        contacts = np.zeros((len(gaps), 4))
        contacts[:, 0] = np.where(gaps < 0, gaps, OPEN)
        data.SetDataCoordinates(contacts.ravel(), configuration=initial)

    def advance(self, n: int) -> tuple[Floats, Floats]:
        """Take n steps, and return the velocities in m/s and heights in m that the engine's sensors have recorded."""
        integration = self._settings.timeIntegration
        integration.numberOfSteps, integration.endTime = n, n * self._step
        if not self._system.SolveDynamic(self._settings, updateInitialValues=True, showHints=False):
            raise RuntimeError("Exudyn's solver gave up")
        states = np.array([self._system.GetSensorStoredData(sensor)[-n:, 3] for sensor in self._sensors])
        velocities, heights = states.reshape(2, len(self._nodes), n)
        return velocities.T * self._speed, heights.T * self._length

    def weightless(self, velocities: Floats, heights: Floats) -> None:
        """Continue without gravity from the given velocities in m/s and heights in m."""
        for load in self._loads:
            self._system.SetLoadParameter(load, "loadVector", [0.0, 0.0, 0.0])
        self._write_state(velocities, heights)


def _build(
    system: ExudynSystem, scene: Scene, model: int, mass: float, time: float, radius: float
) -> tuple[list[object], list[object], list[object]]:
    """Add balls, table and contacts to a system. Return the nodes, the loads of gravity and the contacts.

    `mass`, `time` and `radius` are the engine's units in SI units.
    """
    items = import_module("exudyn.itemInterface")
    nodes: list[object] = []
    loads: list[object] = []
    markers: list[object] = []
    balls = len(scene.masses)
    for i, ball_mass in enumerate(scene.masses):
        place = [0.0, 0.0, 2.0 * (balls - i) - 1.0]
        nodes.append(system.AddNode(items.NodePoint(referenceCoordinates=place)))
        body = system.AddObject(items.ObjectMassPoint(mass=ball_mass / mass, nodeNumber=nodes[-1]))
        markers.append(system.AddMarker(items.MarkerNodePosition(nodeNumber=nodes[-1])))
        if scene.gravity:
            marker = system.AddMarker(items.MarkerBodyMass(bodyNumber=body))
            weight = [0.0, 0.0, -scene.gravity * time**2 / radius]
            loads.append(system.AddLoad(items.LoadMassProportional(markerNumber=marker, loadVector=weight)))
    if scene.table:
        ground = system.AddObject(items.ObjectGround(referencePosition=[0.0, 0.0, -1.0]))
        markers.append(system.AddMarker(items.MarkerBodyPosition(bodyNumber=ground)))
    contacts: list[object] = []
    for i, (contact, e) in enumerate(zip(scene.contacts, scene.restitutions, strict=True)):
        pulling = KelvinVoigtContact.from_restitution(contact.k, e, contact.mass, "naive")
        node = system.AddNode(
            items.NodeGenericData(initialCoordinates=[OPEN, 0.0, 0.0, 0.0], numberOfDataCoordinates=4)
        )
        numbers = {"contactDamping": pulling.c * time / mass} if model == 0 else {"restitutionCoefficient": e}
        contacts.append(
            system.AddObject(
                items.ObjectContactSphereSphere(
                    markerNumbers=markers[i : i + 2],
                    nodeNumber=node,
                    spheresRadii=[1.0, 1.0],
                    contactStiffness=contact.k * time**2 / mass,
                    impactModel=model,
                    **numbers,
                )
            )
        )
    return nodes, loads, contacts


def _settings(exudyn: ModuleType) -> ExudynSettings:
    """Return solver settings with a fixed step, without output files, and with a record of every step."""
    settings = exudyn.SimulationSettings()
    integration = settings.timeIntegration
    integration.verboseMode = 0
    integration.adaptiveStep = False
    integration.generalizedAlpha.useNewmark = True
    integration.discontinuous.useRecommendedStepSize = False
    integration.discontinuous.iterationTolerance = CONTACT_TOLERANCE
    settings.solution.file.write = False
    settings.solution.sensors.writePeriod = 0.0
    return settings


class Exudyn(Engine):
    """Exudyn with springs and dashpots (impact model 0)."""

    name = distribution = module = "exudyn"
    title = "Exudyn"
    law = "linear-dashpot"
    oldest = "1.13"
    rounding = 1e-6

    #: Value of the engine's setting `impactModel`.
    impact_model = 0

    def refusal(self, scene: Scene) -> str | None:
        """Return a sentence that says why Exudyn cannot take a scene, or None.

        Exudyn has only the calibrated mapping. Models 1 and 2 fail for a contact that is at rest at the start.
        """
        if scene.mapping != "calibrated":
            return f"mapping = {scene.mapping!r}: Exudyn has only one mapping; legal: 'calibrated'"
        if scene.gravity and self.impact_model:
            return "scenario = 'drop': B2's contact has no speed at which it began; legal: 'impact'"
        return None

    def world(self, scene: Scene) -> ExudynWorld:
        """Set up a scene in a new system."""
        return ExudynWorld(scene, self.radius(scene), self.impact_model)


class ExudynHuntCrossley(Exudyn):
    """Exudyn with impact model 1, after Hunt and Crossley."""

    law, impact_model = None, 1


class ExudynCarvalhoMartins(Exudyn):
    """Exudyn with impact model 2, after Carvalho and Martins."""

    law, impact_model = None, 2
