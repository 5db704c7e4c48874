"""Experiments behind the numbers in the documentation; `python -m studies.MODULE`."""
