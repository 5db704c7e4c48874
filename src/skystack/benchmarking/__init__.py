"""Benchmarks of skystack and of alternatives."""
