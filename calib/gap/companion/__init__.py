"""Effects that a simulated or nominal recording shows by itself, and their subtraction from the problem."""
