"""Tests of the model, which run with its kernels interpreted too (NUMBA_DISABLE_JIT=1), where fewer cells must do."""

import pytest

from impact_xval.model.compiled import INTERPRETED

#: For what rarely happens: so many cells that interpreted kernels would take an hour.
compiled_only = pytest.mark.skipif(INTERPRETED, reason="too many cells for interpreted kernels")


def sample(cells: int) -> int:
    """Return how many cells, or columns, to try: by interpreted kernels a twentieth, and five at least."""
    return max(5, cells // 20) if INTERPRETED else cells
