"""The one exception for what a user can mend: its message is a sentence, and the command exits with code 1."""


class TrainerError(Exception):
    """Something is wrong with what was asked for, or with the player; the message says what and how to mend it."""
