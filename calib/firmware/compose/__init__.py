"""From fits to a plan of parameters."""
