"""What keeps the theorems: certified headings, gated turn rates, bounds, certificates."""
