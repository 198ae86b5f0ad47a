"""The page's colours: a role has one on every picture, and a run's line is seen on either theme.

The style sheets, which import nothing, are read as text.
"""

import re
from pathlib import Path

import pytest

import trainer.viewer
from corridor_server.corridor import colours

SOURCES = Path(trainer.viewer.__file__).parent / "page" / "src"


def on_page(sheet: str, scheme: str) -> dict[str, str]:
    """A style sheet's colours by name."""
    light, _, dark = (SOURCES / sheet).read_text().partition("@media (prefers-color-scheme: dark)")
    return dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6});", light if scheme == "light" else dark))


def luminance(colour: str) -> float:
    """WCAG 2's relative luminance of #rrggbb."""
    shares = [int(colour[at : at + 2], 16) / 255 for at in (1, 3, 5)]
    linear = [share / 12.92 if share <= 0.04045 else ((share + 0.055) / 1.055) ** 2.4 for share in shares]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(one: str, other: str) -> float:
    """WCAG 2's contrast ratio."""
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def test_the_page_shows_the_roles_in_the_pictures_colours():
    light = on_page("page.css", "light")
    assert light["learner"] == colours.hexadecimal(colours.LEARNER) == "#e8850c"
    assert light["opponent"] == colours.hexadecimal(colours.OPPONENT)
    assert light["switch"] == colours.hexadecimal(colours.SWITCH_ON)
    assert light["text"] == colours.hexadecimal(colours.TEXT)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_runs_colour_has_a_contrast_of_3_to_1_to_what_is_behind_it(scheme):
    assert contrast("#000000", "#ffffff") == pytest.approx(21)
    behind, lines = on_page("page.css", scheme), on_page("learning.css", scheme)
    number = int(re.search(r"COLOURS = (\d+)", (SOURCES / "runstyle.ts").read_text())[1])
    assert set(lines) == {f"run-{index}" for index in range(number)}
    assert len(set(lines.values())) == number
    for name, colour in lines.items():
        for background in ("panel", "back"):
            assert contrast(colour, behind[background]) >= 3, (name, background)
