"""Measures of finished cells: divergence from the model, its split into causes, convergence, and statistics.

The modules import the packages `tables` and `config` of `experiments`.
"""
