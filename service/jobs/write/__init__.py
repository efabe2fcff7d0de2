"""From an accepted plan to its end: guard, steps, check, transaction and outcome."""
