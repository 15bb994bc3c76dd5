"""Pages of runs, section by section, and what moves in them."""
