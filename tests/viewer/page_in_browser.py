"""What the tests of the page share: waiting in a real browser, reading the page, and comparing screenshots."""

import io
import os
from typing import Any

import numpy as np
from PIL import Image
from recorded_run import GOLDEN

PHONE = {"width": 390, "height": 844}
# Baselines are compared at a quarter of their size; text is drawn differently from machine to machine.
CHANNEL_TOLERANCE, SHARE_TOLERANCE = 30, 0.02
VIEW_TOLERANCE = 0.002  # of a view alone, which has hardly any text

MINUS = "\N{MINUS SIGN}"


def until(opened: Any, condition: str, seconds: float = 120) -> None:
    """Waits; Playwright's own wait evaluates strings in the page, which the page's security policy forbids."""
    for _ in range(round(seconds / 0.05)):
        if opened.evaluate(condition):
            return
        opened.wait_for_timeout(50)
    raise AssertionError(f"it never came to {condition}; the page says {opened.inner_text('body')[:500]}")


def settle(opened: Any) -> None:
    """Waits until what was asked for is drawn."""
    opened.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")


def shown(opened: Any, number: int) -> None:
    """Waits until an episode is on the stage."""
    until(opened, f"corridor.list.onStage === {number}")
    settle(opened)


def choose(opened: Any, number: int) -> None:
    opened.click(f"[data-number='{number}']")
    shown(opened, number)


def at(opened: Any, row: int) -> None:
    opened.evaluate(f"corridor.stage.seek({row})")
    settle(opened)


def is_firefox(opened: Any) -> bool:
    return str(opened.context.browser.browser_type.name) == "firefox"


def tap(opened: Any, selector: str) -> None:
    """Touches the middle of an element; in Firefox, where Playwright has no finger, clicks on it."""
    element = opened.locator(selector)
    if is_firefox(opened):
        element.click()
    else:
        element.tap()


def readout(opened: Any) -> dict[str, str]:
    return dict(
        opened.eval_on_selector_all("#readout div", "all => all.map(d => [...d.children].map(c => c.innerText))")
    )


def pixels(png: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB").reduce(4)).astype(int)


def differing(one: np.ndarray, other: np.ndarray) -> float:
    """The share of pixels that differ."""
    assert one.shape == other.shape
    return float((np.abs(one - other).max(axis=-1) > CHANNEL_TOLERANCE).mean())


def compare(opened: Any, name: str, selector: str | None = None) -> None:
    """Holds a screenshot against golden/page/NAME.png; UPDATE_BASELINES=1 writes it anew."""
    baseline = GOLDEN / "page" / f"{name}.png"
    taken = baseline.with_name(f"{name}.taken.png")
    source = opened.locator(selector) if selector else opened
    source.screenshot(path=taken)
    if os.environ.get("UPDATE_BASELINES"):
        Image.open(taken).convert("RGB").quantize(192, dither=Image.Dither.NONE).save(baseline, optimize=True)
        taken.unlink()
        return
    share, tolerance = differing(pixels(baseline.read_bytes()), pixels(taken.read_bytes())), SHARE_TOLERANCE
    if selector:
        tolerance = VIEW_TOLERANCE
    assert share < tolerance, f"{share:.1%} of {name} differs from the baseline: see {taken}"
    taken.unlink()
