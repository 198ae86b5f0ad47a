"""Everything that learns: normalisation, curiosity, PPO and its siblings."""
