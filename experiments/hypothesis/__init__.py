"""The limiting case put to the test: whether an infinitely stiff pair acts as one body."""
