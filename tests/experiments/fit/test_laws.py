"""Every law against its solver, which answers one collision at a time."""

import numpy as np
import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.fit.laws import LAWS, laws_of
from impact_xval.model import Collision, solve

SOLVERS = {
    "bistiffness": ["bistiffness"],
    "kelvin-voigt": ["kelvin-voigt"],
    "hunt-crossley": ["hunt-crossley"],
    "newton": ["newton"],
    "poisson": ["poisson"],
    "sequential": ["sequential-top", "sequential-bottom"],
    "generalised-reflection": ["generalised-reflection"],
}


@pytest.mark.parametrize("name", LAWS)
def test_a_law_answers_as_its_solver_does(name):
    law, random = LAWS[name], np.random.default_rng(3)
    for _ in range(25):
        point = random.uniform(*law.box.T)
        if "log_k" in law.parameters:
            point[0] = random.uniform(-1.5, 1.5)
        mu = 10 ** random.uniform(-1, 1)
        given = dict(zip(law.parameters, point, strict=True))
        e = given.get("e", 0.5)
        c = Collision(
            1.0, mu, 1.0, 10 ** given.get("log_k", 0.0), given.get("e1", e), given.get("e2", e), -1.0
        )
        v1, v2 = law.velocities(point, np.array([mu]))
        if name in SOLVERS:
            outcomes = [get_solver(solver).solve(c) for solver in SOLVERS[name]]
        else:
            outcomes = [
                solve(
                    c, impact_law="jia-mason-erdmann" if name == "state-transition" else "liu-zhao-brogliato"
                )
            ]
        for outcome in outcomes:
            assert (v1[0], v2[0]) == pytest.approx((outcome.v1, outcome.v2), abs=1e-9), (given, mu)


def test_an_unknown_law_is_refused_by_name():
    with pytest.raises(UserError, match=r"law = 'hooke'; legal: state-transition, liu-zhao"):
        laws_of(["newton", "hooke"])
