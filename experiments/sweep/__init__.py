"""Cells by solvers: by whom, isolated, resumed; designs. Imports `measures` and below."""
