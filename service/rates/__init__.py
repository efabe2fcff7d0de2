"""Message rates of vehicles: who uses them, and what is owed back."""
