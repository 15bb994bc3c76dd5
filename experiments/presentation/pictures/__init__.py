"""Figures of runs and of single collisions: statistics, causes, impulse curves, slow motion, and the supplement."""
