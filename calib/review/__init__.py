"""Review of a plan: errors before and after, criteria, mountings, and a picture."""
