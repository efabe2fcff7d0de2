"""What no effect of the catalogue explains: shapes, noise that is no sensor's own, and what is left over."""
