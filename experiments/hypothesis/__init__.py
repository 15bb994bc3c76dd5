"""The limiting case put to the test: is an infinitely stiff pair one body? Imports `presentation` and below."""
