"""Exact and printed velocities of the collisions in the supplement to Jia, Mason and Erdmann (IJRR 32(1), 2013).

Run as ``python examples/supplement.py``. The collisions are of two balls on a table, with the paper's parameters (44).
At infinite and zero k2/k1 the supplement prints limits in closed form. At 40 and 1/40 it prints the results of a
numerical integration, whose steps of finite impulse cause errors (docs/errata.md).
"""

import math

from impact_xval import Collision, solve

MASS_RATIO, E1, E2 = 2 / math.sqrt(3), 0.9, 0.7

#: For each collision a label, k2/k1, and v1 and v2 per |v0| as sections 3.1 and 3.2 of the supplement print them.
PRINTED = (
    ("inf", math.inf, 0.9, 0.0),
    ("40", 40.0, 0.88922, 0.00022),
    ("0", 0.0, 0.45203, 0.45203),
    ("1/40", 1 / 40, 0.4573, 0.44281),
)

print(f"m2/m1 = {MASS_RATIO:.6g}, e1 = {E1}, e2 = {E2}\n")
print("k2/k1    v1/|v0|           v2/|v0|           states")
print("         printed  exact    printed  exact")
for name, stiffness_ratio, v1, v2 in PRINTED:
    outcome = solve(Collision.from_ratios(stiffness_ratio, MASS_RATIO, E1, E2))
    print(
        f"{name:8} {v1:.5f}  {outcome.v1:.5f}  {v2:.5f}  {outcome.v2:.5f}  {' '.join(outcome.states)}".rstrip()
    )
