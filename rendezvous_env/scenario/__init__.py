"""What is simulated: scenario, graph, obstacles, start, reward, layout of an observation."""
