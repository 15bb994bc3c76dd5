"""The limiting case put to the test: does an infinitely stiff pair act as one body?"""
