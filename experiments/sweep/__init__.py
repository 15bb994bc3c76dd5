"""Runs of experiments: solvers solve cells in worker processes; a stopped run continues where it was stopped."""
