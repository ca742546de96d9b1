"""Control of unicycles by a network without a filter, for search with a limited view."""
