"""A role has one colour on every picture: the page's style sheet, which imports nothing, says the same as Python."""

import re
from pathlib import Path

import trainer.viewer
from corridor_server.corridor import colours

STYLE = Path(trainer.viewer.__file__).parent / "page" / "src" / "page.css"


def test_the_page_shows_the_roles_in_the_pictures_colours():
    light = STYLE.read_text().partition("@media")[0]
    on_page = dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6});", light))
    assert on_page["learner"] == colours.hexadecimal(colours.LEARNER) == "#e8850c"
    assert on_page["opponent"] == colours.hexadecimal(colours.OPPONENT)
    assert on_page["switch"] == colours.hexadecimal(colours.SWITCH_ON)
    assert on_page["text"] == colours.hexadecimal(colours.TEXT)
