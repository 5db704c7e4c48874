"""Commands that are interrupted or killed, other processors, an empty environment."""
