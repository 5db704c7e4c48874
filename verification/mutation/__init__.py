"""Mutation testing: whether the tests detect small changes to the code."""
