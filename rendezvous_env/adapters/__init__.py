"""Adapters for learning libraries; each module is imported only on request."""
