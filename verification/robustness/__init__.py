"""Commands that are interrupted or killed, other processors and versions, an empty environment."""
