"""Robot models: how an action moves a robot, and what it keeps and senses of itself."""
