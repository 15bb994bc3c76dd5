"""Rigid contacts: exact impact laws, engines that take a restitution, and which law an engine follows."""
