"""Measurements and trials; run from the root of the repository."""
