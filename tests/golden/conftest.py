"""Numba compiles what the golden values need before the first test, not within one."""

from tests.experiments.conftest import compiled_kernels

__all__ = ["compiled_kernels"]
