"""What another recording shows of its own, which is no gap of this one: baselines and nuisance effects."""
