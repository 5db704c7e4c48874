"""skystack: online action-stacking for air traffic control."""

__version__ = "0.1.0"
