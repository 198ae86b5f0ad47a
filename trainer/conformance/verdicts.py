"""What a sentence of the kit can come to, and the count of what it judged on its way there."""

import unittest


class NotApplicable(unittest.SkipTest):
    """The sentence says nothing about this player, and why. pytest and unittest show it as skipped."""


class NotAsExpected(AssertionError):
    """The sentence does not hold for the player. pytest and unittest show it as a failure."""


class Tally:
    """How many judgements ``expect`` has made; a sentence that made none has not held the player against anything."""

    judgements = 0


def expect(holds: object, came: str, expected: str) -> None:
    """Fails unless the condition holds; unlike ``assert``, under ``python -O`` too. Counts as a judgement.

    Args:
        holds: The condition.
        came: What the player did.
        expected: What it should have done, as a singular: "... was expected" follows.

    Raises:
        NotAsExpected: It does not hold.
    """
    Tally.judgements += 1
    if not holds:
        raise NotAsExpected(f"{came}; {expected} was expected")


def expect_equal(came: object, expected: object, what: str) -> None:
    """Fails unless two values are equal. Counts as a judgement.

    Args:
        came: The player's.
        expected: The one to compare with.
        what: What they are, to stand before the value.

    Raises:
        NotAsExpected: They differ.
    """
    expect(came == expected, f"{what} {came}", str(expected))
