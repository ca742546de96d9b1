"""Kernels as functions of arrays, random streams, and work on a few environments of a batch."""
