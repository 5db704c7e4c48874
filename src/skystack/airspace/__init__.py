"""Where aircraft fly: geometry on arrays, projection, fixes, routes and sectors."""
