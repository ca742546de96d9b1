"""HTML report of a comparison or a leaderboard."""
