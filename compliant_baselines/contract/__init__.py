"""What a solver is, when a collision is over, how states are read, and where solvers are found. Imports the model."""
