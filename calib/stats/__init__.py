"""Statistics of samples: windows, residuals, correlated and quantised means, stillness, the norm equation."""
