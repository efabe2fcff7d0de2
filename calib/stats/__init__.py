"""What samples say: windows, residuals, correlated and quantised means, stillness, the norm equation."""
