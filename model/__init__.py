"""The primary solver."""
