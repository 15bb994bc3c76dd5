"""One collision, or one column, by every solver side by side; may import all below but `hypothesis`."""
