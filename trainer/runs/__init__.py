"""A training run: its folder, its checkpoints, its evaluation."""
