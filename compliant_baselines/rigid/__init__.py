"""Rigid laws in closed form: contacts of a coefficient of restitution and nothing else, for N balls in a line.

Imports the contract and the model; `docs/rigid.md` has the laws with their sources.
"""
