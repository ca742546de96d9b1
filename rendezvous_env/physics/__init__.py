"""The physics as pure functions: no batch, no lane, no thread."""
