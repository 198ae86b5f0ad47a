"""A role has one colour on every picture, and every mark stands out from what is behind it, by day and by night."""

import re
from pathlib import Path

import pytest

import trainer.viewer
from corridor_server.corridor import colours

SOURCES = Path(trainer.viewer.__file__).parent / "page" / "src"
GROUNDS = ("back", "panel")
PICTURE = ("floor", "sky")
# What is read as text, and what is seen as a mark, each with what it stands on (WCAG 1.4.3 and 1.4.11).
TEXT = {"text": GROUNDS, "muted": GROUNDS, "learner-text": GROUNDS, "opponent-text": GROUNDS, "switch-text": GROUNDS}
MARKS = {
    "learner-text": (*GROUNDS, *PICTURE),  # the learner's outline and way, its target's ring, the reward's line
    "opponent": (*GROUNDS, *PICTURE),
    "opponent-text": GROUNDS,
    "switch-text": (*GROUNDS, *PICTURE),
    "muted": GROUNDS,
    "text": (*GROUNDS, "floor"),  # the slider, the time's line, the action's arrow
    "wall": ("floor", "panel"),
    "action-x": GROUNDS,
    "action-z": GROUNDS,
    "focus": GROUNDS,
}


def luminance(colour: str) -> float:
    """Of WCAG 2: of ``#rrggbb``, from 0 for black to 1 for white."""
    parts = [value / 255 for value in bytes.fromhex(colour[1:])]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(one: str, other: str) -> float:
    """Of WCAG 2: from 1 for equal colours to 21 for black on white."""
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def palette(scheme: str, sheet: str = "page.css") -> dict[str, str]:
    """A style sheet's colours by name; the sheets import nothing, and are read as text."""
    light, _, rest = (SOURCES / sheet).read_text().partition("@media (prefers-color-scheme: dark)")
    return dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6});", light if scheme == "light" else rest))


def test_the_page_shows_the_roles_in_the_pictures_colours():
    on_page = palette("light")
    assert on_page["learner"] == colours.hexadecimal(colours.LEARNER) == "#e8850c"
    assert on_page["opponent"] == colours.hexadecimal(colours.OPPONENT)
    assert on_page["switch"] == colours.hexadecimal(colours.SWITCH_ON)
    assert on_page["text"] == colours.hexadecimal(colours.TEXT)


def test_contrast_is_wcags():
    assert contrast("#000000", "#ffffff") == pytest.approx(21)
    assert contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.005)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_and_marks_stand_out(scheme):
    on_page = palette(scheme)
    weak = {
        (name, ground): ratio
        for wanted, least in ((TEXT, 4.5), (MARKS, 3.0))
        for name, grounds in wanted.items()
        for ground in grounds
        if (ratio := contrast(on_page[name], on_page[ground])) < least
    }
    assert weak == {}
    assert set(palette("light")) == set(palette("dark"))


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_runs_colour_stands_out(scheme):
    behind, lines = palette(scheme), palette(scheme, "learning.css")
    number = int(re.search(r"COLOURS = (\d+)", (SOURCES / "runstyle.ts").read_text())[1])
    assert set(lines) == {f"run-{index}" for index in range(number)}
    assert len(set(lines.values())) == number
    for name, colour in lines.items():
        for ground in GROUNDS:
            assert contrast(colour, behind[ground]) >= 3, (name, ground)
