"""Proof that written parameters took effect: a new stream judged under old and new values."""
