"""What no effect of the catalogue explains: unnamed shapes, noise of no sensor, and power in the residual."""
