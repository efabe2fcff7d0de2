"""What a report says of a model: parameters, probabilities, places, series and inputs."""
