"""The largest scenarios that files, settings and arguments may ask for."""

MOST_CYCLES = 10_000
"""More than 16 hours."""
MOST_AIRCRAFT = 200
MOST_TYPES = 20
"""The maximum number of types in a fleet."""
