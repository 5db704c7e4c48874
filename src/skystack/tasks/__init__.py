"""Tasks: observations, action tables, rewards, metrics and the end of a scenario."""
