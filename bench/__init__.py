"""What mavcal costs and reaches, measured: every figure beside its target or its peer, in one run."""
