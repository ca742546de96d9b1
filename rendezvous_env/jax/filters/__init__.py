"""Safety filters over arrays, with the settings of the engine's filters."""
