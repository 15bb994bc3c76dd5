"""A box that lands flat on two corners with different stiffnesses, k1 and k2, and turns as it rebounds.

It does not turn if its moment of inertia is I = m a^2, with the mass m and half the width a.

Run as ``python examples/graph_box.py``. The columns are I/(m a^2), k2/k1, and the vertical velocity in m/s and the
angular velocity in rad/s after the collision.
"""

from impact_xval.model.graph import box, solve_graph_collision

for inertia in (1 / 3, 2 / 3, 1.0):
    for ratio in (1.0, 1.1, 3.0):
        outcome = solve_graph_collision(box(inertia, stiffness_ratio=ratio, restitution=0.8))
        ((_, up),), ((turning,),) = outcome.velocities, outcome.angular_velocities
        print(f"{inertia:6.3f} {ratio:5g}   {up:8.5f} {turning:8.5f}")
