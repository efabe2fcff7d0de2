"""Every real recording with a known answer, fitted and compared: ``python -m bench.realdata``."""
