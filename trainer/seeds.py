"""Every seed that follows from a run's: of its players, of the samplers it sends them, of its evaluation."""

LIMIT = 2**31  # the protocol carries int32; seeds are never negative
PLAYER_STRIDE = 2**24
LIFE_STRIDE = 2**16 + 1
# Evaluation plays episodes that training has not seen.
EVALUATION_OFFSET = 1_000_000


def player_seed(seed: int, number: int, life: int = 0) -> int:
    """The seed of a run's player.

    Args:
        seed: Player 0's, in its first life.
        number: Which player, from 0.
        life: How often it was started before: a player that died does not play its first episodes once more.
    """
    return (seed + number * PLAYER_STRIDE + life * LIFE_STRIDE) % LIMIT


def sampler_seed(seed: int, index: int) -> int:
    """The seed of a player's sampler: the player's own, and the parameter's place more, as in ``mlagents-learn``."""
    return (seed + index) % LIMIT


def evaluation_seed(seed: int) -> int:
    """The seed of the player that a run with this seed is evaluated on."""
    return (seed + EVALUATION_OFFSET) % LIMIT
