"""Cells by solvers: by whom, isolated, resumed; designs and search. Imports `measures` and below."""
