"""A cue ball strikes a rack of billiard balls, all of which touch.

Run as ``python examples/graph_rack.py [3, 6 or 10]``. Rows are the balls, the cue ball first: velocity (x, z) in m/s
afterwards, for a cue ball with 1 m/s along x.
"""

import sys

from impact_xval.model.graph import rack, solve_graph_collision

balls = int(sys.argv[1]) if len(sys.argv) > 1 else 10
collision = rack(balls, restitution=0.95)
outcome = solve_graph_collision(collision)
for number, (x, z) in enumerate(outcome.velocities, 1):
    print(f"ball {number:2d}   {x:8.5f} {z:8.5f}")
print(f"{len(collision.contacts)} contacts, {outcome.n_events} events: {outcome.status}")
