"""Experiments: many collisions solved by every solver, the tables and pages of the results, and the command line."""
