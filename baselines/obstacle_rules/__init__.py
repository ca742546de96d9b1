"""Analytic rules that go round obstacles."""
