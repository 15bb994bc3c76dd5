"""A ball that meets two walls at once, for several angles between the walls and ratios of their stiffnesses.

Run as ``python examples/graph_corner.py``. The columns are the angle between the walls' normals in degrees, k2/k1, the
velocity (x, z) after the collision in m/s, and the sets of contacts that were active, in the order of time.
"""

from impact_xval.model.graph import corner, solve_graph_collision

for angle in (60, 90, 120):
    for ratio in (0.1, 1, 10):
        collision = corner(angle, stiffness_ratio=ratio, restitutions=(0.9, 0.7))
        outcome = solve_graph_collision(collision)
        x, z = outcome.velocities[0]
        print(f"{angle:4d} {ratio:5g}   {x:8.5f} {z:8.5f}   {' '.join(outcome.states)}")
