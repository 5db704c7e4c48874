"""How policies are learned and kept: networks, PPO, training runs, policy files."""
