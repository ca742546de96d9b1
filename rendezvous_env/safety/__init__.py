"""Safety filters, theorems and certificates."""
