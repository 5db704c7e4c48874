"""Other simulators behind one protocol, and clearances in their languages and in words."""
