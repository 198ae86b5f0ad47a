"""The exception for what a user can mend: its message is a sentence, and the command exits with code 1."""


class TrainerError(Exception):
    """Something is wrong with what was asked for, or with the player; the message says what and how to mend it."""


class SettingError(TrainerError):
    """A setting can't be used. It knows which one, so that who reads a file can name its line.

    Args:
        message: What is wrong.
        where: The names and indices that lead to the setting.
    """

    def __init__(self, message: str, *where: object) -> None:
        super().__init__(message)
        self.where = where

    def within(self, *above: object) -> "SettingError":
        """The same of a setting that stands inside another one."""
        return SettingError(str(self), *above, *self.where)
