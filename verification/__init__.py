"""Checks that run for minutes or hours; run as `python -m verification.PACKAGE.MODULE`."""
