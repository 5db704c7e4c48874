"""What is asked of a controller: observation, action table, rewards, end of scenario."""
