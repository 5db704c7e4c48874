"""The live session: traffic that a person, an agent or both control."""
