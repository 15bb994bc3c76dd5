"""Commands whose result is a picture."""
