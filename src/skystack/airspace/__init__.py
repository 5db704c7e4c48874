"""Airspace: geometry on arrays, the projection, fixes, routes and sectors."""
