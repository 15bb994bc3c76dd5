"""Parts of kernels, which only kernels call, made callable."""

from numba import njit


def from_python(part):
    """Return a part of a kernel as a kernel of its own."""
    return njit(lambda *numbers: part(*numbers))
