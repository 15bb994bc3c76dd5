"""The contact a scene will have, and the traps in it. Imports `calibration` and below."""
