"""From a model to a report: parameters, probabilities, places, series and inputs."""
