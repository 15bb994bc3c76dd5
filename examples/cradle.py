"""Newton's cradle, two balls on three: the model, the same springs in time, and rigid restitution.

All balls are equal, and e = 0.95 at every contact. With positions that move, springs answer what the model does; rigid
restitution, solved at all contacts at once, does not.
"""

from impact_xval import Column, get_solver

BALLS, STRIKE = 5, 2
cradle = Column(
    masses=(1.0,) * BALLS,
    stiffnesses=(1e8,) * (BALLS - 1),
    restitutions=(0.95,) * (BALLS - 1),
    velocities=(-1.0,) * STRIKE + (0.0,) * (BALLS - STRIKE),
)

answers = {}
for name in ("state-transition", "bistiffness", "kelvin-voigt", "mujoco", "newton"):
    outcome = get_solver(name).solve_column(cradle)
    answers[name] = outcome.velocities
    print(f"{name:17}", " ".join(f"{v:7.4f}" for v in outcome.velocities))

for velocities in answers.values():
    assert abs(sum(velocities) + STRIKE) < 1e-6  # momentum stays: no table
difference = max(abs(a - b) for a, b in zip(answers["state-transition"], answers["bistiffness"], strict=True))
assert difference < 1e-9
