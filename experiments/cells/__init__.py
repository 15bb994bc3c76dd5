"""One collision, chain or contact graph by every solver side by side, and the explorer."""
