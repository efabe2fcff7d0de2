"""The model of a diagnosis: series, bands, what competes to explain them, and the joint fit of mean and noise."""
