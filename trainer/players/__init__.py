"""Players, opened: the connection, the environment over it, and the wrappers for Gymnasium and Stable-Baselines3."""
