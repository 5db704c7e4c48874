"""The groups of figures that can be measured by themselves. Imports nothing."""

GROUPS = ("start", "simulator", "training", "gpu", "success", "sector", "decisions")
"""In the order in which they are measured."""
