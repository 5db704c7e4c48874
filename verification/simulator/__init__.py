"""Check the simulator against closed forms, BluebirdDT, and itself in random traffic."""
