"""Test the readers of files with millions of damaged and hostile inputs."""
