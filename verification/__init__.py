"""Checks of skystack that run for minutes or hours; `python -m verification.PACKAGE.MODULE`."""
