"""One physics engine a file, what they share, and the limit dt -> 0. Imports `references` and below."""
