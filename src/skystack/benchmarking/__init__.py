"""How fast it is: our own figures, and those of what a user would pick instead."""
