"""Maintenance: licences and shipped policies; `python -m tools.MODULE`."""
