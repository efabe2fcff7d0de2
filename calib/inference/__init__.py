"""Posterior over sets of effects: marginal likelihoods, prior odds, and sums over the visited models."""
