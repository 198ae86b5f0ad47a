"""What commands print on, where every text is only text."""

import re
from typing import Any

from rich.console import Console
from rich.text import Text

# What moves a terminal's cursor, colours it or turns the direction of writing; line ends and tabs are text.
CONTROLS = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")


class Terminal(Console):
    """A console that takes nothing in a string for markup, an emoji, a control code or a number to colour.

    Whatever is printed may hold a path, a name or a message of a file or a player. What has a style is given as
    ``Text``. Characters that the stream has none for are written as escapes.

    Args:
        **options: Rich's, such as ``stderr``.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(markup=False, emoji=False, highlight=False, soft_wrap=True, **options)

    def render_str(self, text: str, **options: Any) -> Text:
        """A string as it is printed."""
        visible = CONTROLS.sub(lambda found: found.group().encode("unicode_escape").decode(), text)
        return super().render_str(visible.encode(self.encoding, "backslashreplace").decode(self.encoding), **options)

    def print_failure(self, label: str, text: str) -> None:
        """A line about what went wrong, begun by a label."""
        self.print(Text(label, "bold red"), text)
