"""The search for effects: the gain of each hypothesis, its price, and the selection."""
