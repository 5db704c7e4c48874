"""The simulator: aircraft state, performance models, instruct and advance, scenarios."""
