"""The terms of the team reward."""
