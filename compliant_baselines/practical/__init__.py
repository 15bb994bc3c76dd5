"""Engines as people run them, each with the settings that it ships or documents. Imports `engines` and below."""
