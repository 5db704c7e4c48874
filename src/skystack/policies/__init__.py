"""The policies that ship with the package, each in a folder, and what was measured of them."""
