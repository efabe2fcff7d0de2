"""Effects that a simulated or nominal recording shows by itself, and the problem without them."""
