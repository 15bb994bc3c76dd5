"""Many collisions at once are shared out to threads: each is followed, and as it would be alone."""

import numpy as np

from impact_xval.compliant_baselines.references.bistiffness import bistiffness_batch


def test_the_size_of_a_batch_changes_no_bit():
    rng = np.random.default_rng(3)
    n = 5000  # more than one thread is given at once
    cells = 10 ** rng.uniform(-2, 2, n), 10 ** rng.uniform(-1, 1, n), *rng.uniform(0.1, 1, (2, n))
    whole = bistiffness_batch(*cells, 1e-4)
    assert set(whole.status) <= {"ok", "limit"}
    for start in range(0, n, 999):
        some = bistiffness_batch(*(column[start : start + 999] for column in cells), 1e-4)
        for name in ("v1", "v2", "sequence", "duration", "status"):
            assert np.array_equal(getattr(some, name), getattr(whole, name)[start : start + 999])


def test_a_batch_starts_no_threads_of_numba(monkeypatch):
    def launch():
        raise AssertionError("numba's own threads were started")

    monkeypatch.setattr("numba.np.ufunc.parallel._launch_threads", launch)
    assert bistiffness_batch(np.ones(5000), 1.0, 0.9, 0.7, 0.0).status[-1] == "ok"
