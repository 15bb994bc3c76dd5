"""Newton's cradle, in which one steel ball strikes four: by the model, by laws in time, and by engines.

Run as ``python examples/cradle.py [SOLVER ...]``. A row has the final velocities by one solver. D is their difference
from the model, weighted by mass and divided by the speed of impact. All rows have linear contacts that replace Hertz's
contacts, except the last row, which is the model with Hertz's contacts themselves.
"""

import sys

import numpy as np

from impact_xval import get_solver
from impact_xval.compliant_baselines import SolverError
from impact_xval.model.kinetic import kinetic_norm
from impact_xval.model.materials import MATERIALS, Body, line

RADIUS, SPEED = 0.01, 1.0  # m, m/s
SOLVERS = ("state-transition", "bistiffness", "kelvin-voigt", "mujoco", "pybullet")

balls = [Body(MATERIALS["steel"], RADIUS)] * 5
start = (-SPEED, 0.0, 0.0, 0.0, 0.0)
linear, hertz = line(balls, start), line(balls, start, exponent=1.5)

model = get_solver("state-transition").solve(linear)
print("velocities in m/s of balls 1 to 5, ball 1 strikes downwards")


def show(name, velocities):
    """Print a row: the name of a solver, its final velocities, and D."""
    difference = np.subtract(velocities, model.velocities)
    D = kinetic_norm(linear.masses, difference) / kinetic_norm(linear.masses, start)
    print(f"{name:24}", " ".join(f"{v:8.4f}" for v in velocities), f"  D = {D:.4f}")


for name in sys.argv[1:] or SOLVERS:
    try:
        show(name, get_solver(name).solve(linear).velocities)
    except SolverError as error:
        print(f"{name:24} {error}")
show("state-transition, Hertz", get_solver("state-transition").solve(hertz).velocities)
