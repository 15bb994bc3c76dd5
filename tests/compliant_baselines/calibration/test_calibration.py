from itertools import product

import numpy as np
import pytest

from impact_xval.compliant_baselines.calibration.calibration import (
    ContactRequest,
    calibrate,
    contact_limit,
)

FRACTIONS = (1e-3, 5e-4, 2.5e-4, 1.25e-4)


def test_single_contacts_converge_to_what_was_asked_for_at_first_order(engine):
    for contact, e, k in product(("ball-table", "ball-ball"), (0.2, 0.6, 1.0), (1e2, 1e8)):
        requests = [ContactRequest(contact, e, k, 1.0, 2 / 3**0.5, step_fraction=f) for f in FRACTIONS]
        results = calibrate(engine, requests)
        restitution = np.array([result.restitution for result in results])
        ratio = np.array([result.duration / result.duration_asked for result in results])
        limit = contact_limit(e, restitution, ratio)
        # sharper than anybody asks, since nothing but the second order is left
        assert (limit.restitution, limit.duration) == (
            pytest.approx(e, abs=5e-6),
            pytest.approx(1, abs=5e-6),
        ), requests[0]
        of_e, _, of_both = limit.orders
        assert of_both == pytest.approx(1, abs=0.1), requests[0]
        if engine.name == "mujoco" and e == 1:
            assert of_e > 1.9  # a symplectic step loses no energy of a spring
        else:
            assert of_e == pytest.approx(1, abs=0.1), requests[0]
