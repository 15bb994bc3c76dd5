"""One collision, or one column, by every solver side by side: as text, in a notebook, and in a browser as it moves.

May import everything below but `hypothesis`, which knows nothing of single cells.
"""
