"""What mavcal costs and reaches, measured: every figure beside its target or its peer, in one run."""

import mavcal.service  # noqa: F401  # sets how many threads BLAS has, before numpy is loaded
