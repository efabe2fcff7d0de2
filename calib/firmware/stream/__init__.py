"""What the vehicles' messages carry, as recordings."""
