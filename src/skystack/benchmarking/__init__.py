"""Speed: figures of skystack, and of its alternatives."""
