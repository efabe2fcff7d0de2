"""What each effect of a model is worth: its share, its rivals, and how sure its amplitudes are."""
