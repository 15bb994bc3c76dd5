"""The kinds of cells of a run, collisions of two balls and columns of N: how each is solved, what its rows hold.

May import what `sweep.kernels` may, and it; what solves and keeps rows, above, knows a kind by `Kind` alone.
"""
