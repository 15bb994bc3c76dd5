"""Measured collisions and the laws: which explains them, with which parameters, and how sure that is."""
