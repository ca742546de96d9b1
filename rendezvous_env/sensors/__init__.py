"""What a robot sees of its neighbours: exact bearings, and imperfections composed in order."""
