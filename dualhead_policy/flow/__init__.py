"""Flow matching: noise, loss, diagnostics and the solver."""
