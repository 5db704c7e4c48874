"""The largest scenarios that files, settings and arguments may ask for."""

MAX_CYCLES = 10_000
"""More than 16 hours."""
MAX_AIRCRAFT = 200
MAX_TYPES = 20
"""The maximum number of types in a fleet."""
