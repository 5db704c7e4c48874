"""Learning: networks, PPO, training runs, checkpoints and policy files."""
