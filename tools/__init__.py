"""Maintenance of licences and shipped policies; run as `python -m tools.MODULE`."""
