"""Reproduce the paper: train, evaluate and compare. Finished pieces of work are cached."""
