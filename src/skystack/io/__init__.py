"""Files, JSON, TOML, locks, names, standard streams and signals."""
