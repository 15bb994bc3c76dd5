"""Rigid contacts: exact impact laws, and adapters of engines that take a restitution."""
