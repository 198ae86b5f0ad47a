"""What has which colour, on every picture of the corridor."""

Colour = tuple[int, int, int]  # red, green, blue, each from 0 to 255

BACKGROUND: Colour = (255, 255, 255)
FLOOR: Colour = (238, 238, 234)
WALL: Colour = (85, 85, 85)
TEXT: Colour = (30, 34, 39)
# The paper's roles: orange learner and target, purple opponent and target.
LEARNER: Colour = (232, 133, 12)
OPPONENT: Colour = (123, 63, 160)
SWITCH_OFF: Colour = (190, 205, 195)
SWITCH_ON: Colour = (0, 158, 115)  # told from orange and purple by the colour-blind, too


def hexadecimal(colour: Colour) -> str:
    """A colour as style sheets and Matplotlib take it, such as ``#e8850c``."""
    return "#" + bytes(colour).hex()
