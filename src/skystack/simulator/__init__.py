"""What flies: aircraft state, performance models, instruct and advance, scenarios."""
