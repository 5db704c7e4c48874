"""The policies that ship with the package, one folder each, and their measured results."""
