"""Terms of the team reward, and costs."""
