"""The model of a diagnosis: series and bands, hypotheses, and the joint fit of mean and noise."""
