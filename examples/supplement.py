"""The supplement's two cases: the exact model beside what is printed.

Jia, Mason and Erdmann (IJRR 32(1), 2013), supplementary material, section 3.1 with the parameters (44). Why the printed
velocities differ in the fourth digit: docs/errata.md.
"""

import math

from impact_xval import Collision, solve

PRINTED = {40.0: (0.88922, 0.00022), 1 / 40: (0.4573, 0.44281)}

for stiffness_ratio, printed in PRINTED.items():
    collision = Collision.from_ratios(
        stiffness_ratio=stiffness_ratio, mass_ratio=2 / math.sqrt(3), e1=0.9, e2=0.7
    )
    outcome = solve(collision)
    print(f"k2/k1 = {stiffness_ratio:g}: {' '.join(outcome.states)}")
    print(f"  exact   {outcome.v1:.5f} {outcome.v2:.5f} m/s")
    print(f"  printed {printed[0]:.5f} {printed[1]:.5f} m/s")
    assert max(abs(outcome.v1 - printed[0]), abs(outcome.v2 - printed[1])) < 5e-3
