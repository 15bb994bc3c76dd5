"""Columns of N balls: how far outcomes lie from one another, and what a run of them found."""
