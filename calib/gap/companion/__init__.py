"""Effects that a simulated or nominal recording shows by itself. They are no part of the gap."""
