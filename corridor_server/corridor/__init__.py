"""The paper's corridor: the world, its parameters, and areas side by side."""
