"""Answers of every engine when several bodies meet at once, and the exact law that explains them."""
