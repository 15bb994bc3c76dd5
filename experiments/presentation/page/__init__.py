"""What a browser shows: Markdown as one self-contained page, and what moves in it."""
