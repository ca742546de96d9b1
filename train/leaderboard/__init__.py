"""Comparison of learning algorithms over scenarios and seeds: success, contacts, rises of V."""
