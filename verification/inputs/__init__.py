"""Readers of files given millions of damaged and hostile inputs."""
