"""A cue ball strikes a rack of billiard balls, all of which touch.

Run as ``python examples/graph_rack.py [3, 6 or 10]``, with the number of balls in the rack. The cue ball moves along x
at 1 m/s. Each row has the velocity (x, z) in m/s of one ball after the collision. The cue ball is ball 1.
"""

import sys

from impact_xval.model.graph import rack, solve_graph_collision

balls = int(sys.argv[1]) if len(sys.argv) > 1 else 10
collision = rack(balls, restitution=0.95)
outcome = solve_graph_collision(collision)
for number, (x, z) in enumerate(outcome.velocities, 1):
    print(f"ball {number:2d}   {x:8.5f} {z:8.5f}")
print(f"{len(collision.contacts)} contacts, {outcome.n_events} events: {outcome.status}")
