"""One posterior over sets of effects: marginal likelihood, prior inclusion, sums over the models that were visited."""
