"""Divergence, its ladder of causes, estimates of convergence, statistics. Imports `tables` and `config`."""
