"""From a request to a plan: capture, fit, plan."""
