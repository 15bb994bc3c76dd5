"""Measurements that are run by hand; each module says what it prints and how long it takes."""
