"""One collision, or one chain, by every solver side by side; may import all below but `hypothesis`."""
