"""From (k, e) to damping and to each engine's own parameters; a column in SI units. Imports `contract`."""
