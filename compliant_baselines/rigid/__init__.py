"""Rigid contacts: exact impact laws, and adapters of engines that take coefficients of restitution."""
