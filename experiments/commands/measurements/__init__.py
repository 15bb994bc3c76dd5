"""The commands on measured collisions."""
