"""Experiments: grids of cells by every solver, what they say, and the command that runs them."""
