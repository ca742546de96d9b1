"""Robots that see with cameras: MuJoCo draws, a detector looks, a policy drives."""
