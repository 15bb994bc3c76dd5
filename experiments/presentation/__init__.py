"""Figures, templates, report and terminal. Imports `sweep` and below."""
