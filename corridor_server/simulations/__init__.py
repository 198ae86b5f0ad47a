"""What a player plays: any simulation, and those of Gymnasium and PettingZoo."""
