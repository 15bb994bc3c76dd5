"""Exudyn: mass points in a line with `ObjectContactSphereSphere`, solved by the engine's implicit solver.

**Laws.** `impactModel` 0 is F = k delta + c delta' while spheres overlap. The contact may pull, so its law is
`linear-dashpot`. Models 1 and 2 are F = k delta (1 + a delta'), damped in proportion to the depth. They compute a from
the restitution and from the speed at which *this* contact begins (the engine's ObjectContactSphereSphere.rst). The
reference `hunt-crossley` uses one speed for all contacts, so it is not the law of these two models: they have no
reference.

* Model 1 has a = 3 (1 - e)/(2 u), after Hunt and Crossley. Its restitution is larger than e.
* Model 2 has 3 (1 - e) (11 - e)/(2 (1 + 9 e) u), after Carvalho and Martins, and (1 - e^2)/(e u) up to e = 1/3, after
  Gonthier and others. The restitution of a contact alone is within some 1e-3 of e.

A contact whose bodies touch and are at rest begins at a speed that goes to zero with the step, and then its damping
grows beyond all bounds. So under models 1 and 2 a ball that rests on the table stays there when it is struck.

**Integration** is Newmark's method, the trapezoidal rule. The engine's default is the generalised alpha method. Its
acceleration follows the force with a delay: after every step 0.73 of the difference is left, with opposite sign. So
velocities still change for some 20 steps after bodies have parted, as if the contact were active. In a drop gravity
would also end some 20 steps late.

**Bodies.** The table is a fixed sphere of the balls' radius: along one line a sphere and a plane are alike.

**Units** are the radius, the mass of ball 1, and the shortest contact period over 2 pi. The engine's tolerances are
absolute.
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

#: Force up to which a step is not iterated again after a contact began or ended in it. The unit is the force of the
#: unit stiffness at the unit length.
CONTACT_TOLERANCE = 1e-9

#: Gap that marks a contact as open before the start, in the unit of the engine's contact data. Without it the contact
#: has no initial speed.
OPEN = 1.0


class ExudynSystemData(Protocol):
    """The methods of `exudyn.SystemData` that the adapter calls; coordinates have the shape (3 N,)."""

    def SetDataCoordinates(self, coordinates: Floats, *, configuration: object) -> None:
        """Write the data of all contacts, shape (4 C,)."""
        ...

    def SetODE2Coordinates(self, coordinates: Floats, *, configuration: object) -> None:
        """Write coordinates."""
        ...

    def SetODE2Coordinates_t(self, coordinates: Floats, *, configuration: object) -> None:
        """Write velocities of coordinates."""
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

    The result of an `Add` method stands for the item in later calls.
    """

    systemData: ExudynSystemData

    def AddNode(self, item: object) -> object:
        """Add a node."""
        ...

    def AddObject(self, item: object) -> object:
        """Add a body, a ground or a contact."""
        ...

    def AddLoad(self, item: object) -> object:
        """Add a load."""
        ...

    def AddMarker(self, item: object) -> object:
        """Add a marker."""
        ...

    def AddSensor(self, item: object) -> object:
        """Add a sensor."""
        ...

    def Assemble(self) -> None:
        """Finish the system."""
        ...

    def GetObjectParameter(self, item: object, name: str) -> float:
        """Return a number of an object."""
        ...

    def GetSensorStoredData(self, item: object) -> Floats:
        """Return a row of time and three components for every step."""
        ...

    def SetLoadParameter(self, item: object, name: str, value: Sequence[float]) -> bool:
        """Change a number of a load."""
        ...

    def SolveDynamic(self, settings: ExudynSettings, *, updateInitialValues: bool, showHints: bool) -> bool:
        """Run, and return whether the solver succeeded."""
        ...


class ExudynWorld(World):
    """A scene as a system of its own."""

    #: The engine's Newton method ends at some 1e-10 of a force.
    rounding = 2.0**-30
    #: The trapezoidal rule takes half of the force at the end of a step.
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
        """Make velocities in m/s and heights in m, shape (N,), the initial state.

        Contacts whose bodies overlap count as closed before, all others as open.
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
        """Take n steps, which sensors of the engine record."""
        integration = self._settings.timeIntegration
        integration.numberOfSteps, integration.endTime = n, n * self._step
        if not self._system.SolveDynamic(self._settings, updateInitialValues=True, showHints=False):
            raise RuntimeError("Exudyn's solver gave up")
        states = np.array([self._system.GetSensorStoredData(sensor)[-n:, 3] for sensor in self._sensors])
        velocities, heights = states.reshape(2, len(self._nodes), n)
        return velocities.T * self._speed, heights.T * self._length

    def weightless(self, velocities: Floats, heights: Floats) -> None:
        """Go on without gravity from a state."""
        for load in self._loads:
            self._system.SetLoadParameter(load, "loadVector", [0.0, 0.0, 0.0])
        self._write_state(velocities, heights)


def _build(
    system: ExudynSystem, scene: Scene, model: int, mass: float, time: float, radius: float
) -> tuple[list[object], list[object], list[object]]:
    """Add balls, table and contacts, in units of mass, time and radius; return nodes, loads of gravity and contacts."""
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
    """Return settings with a fixed step, without output files, and with a record of every step."""
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
    """Exudyn, spring and dashpot."""

    name = distribution = module = "exudyn"
    title = "Exudyn"
    law = "linear-dashpot"
    oldest = "1.13"
    rounding = 1e-6

    #: The engine's `impactModel`.
    impact_model = 0

    def refusal(self, scene: Scene) -> str | None:
        """Return why Exudyn cannot take a scene: it has one mapping, and models 1 and 2 fail for a contact at rest."""
        if scene.mapping != "calibrated":
            return f"mapping = {scene.mapping!r}: Exudyn has one; legal: 'calibrated'"
        if scene.gravity and self.impact_model:
            return "scenario = 'drop': B2's contact has no speed at which it began; legal: 'impact'"
        return None

    def world(self, scene: Scene) -> ExudynWorld:
        """Set up a scene."""
        return ExudynWorld(scene, self.radius(scene), self.impact_model)


class ExudynHuntCrossley(Exudyn):
    """Exudyn, impact model 1."""

    law, impact_model = None, 1


class ExudynCarvalhoMartins(Exudyn):
    """Exudyn, impact model 2."""

    law, impact_model = None, 2
