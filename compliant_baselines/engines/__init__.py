"""Adapters of physics engines, one file for each engine; their common parts; and the limit dt -> 0."""
