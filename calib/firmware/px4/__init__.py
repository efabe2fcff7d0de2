"""Facts of PX4: parameters, topics and flights."""
