"""Pictures that people ask for by name, and maps of a run: the supplement's figures, one cell, its motion, trust."""
