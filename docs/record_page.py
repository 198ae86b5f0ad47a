"""Makes this folder's pictures of the page: ``python docs/record_page.py results/RUN/replay.html [EPISODE]``.

Writes ``replay.gif``, both views of one episode, and ``page.png``, the whole page. Needs Chromium and Playwright.
"""

import io
import shutil
import sys
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

DOCS = Path(__file__).parent
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
HOLD = 15  # frames on the last decision


def main(page: Path, episode: str | None) -> None:
    """Records one episode, by its number on the page; the one that it opens with if none is given."""
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
        opened = chromium.new_page(viewport={"width": 800, "height": 900})
        opened.goto(page.absolute().as_uri())
        if episode:
            opened.click(f"[data-number='{episode}']")
        opened.add_style_tag(content="#reset-camera { display: none }")
        opened.wait_for_timeout(1000)
        frames = []
        for row in range(int(opened.evaluate("corridor.stage.end")) + 1):
            opened.evaluate(f"corridor.stage.seek({row})")
            opened.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
            shot = opened.locator(".views").screenshot()
            frames.append(Image.open(io.BytesIO(shot)).convert("RGB"))
        middle = len(frames) * 2 // 3
        palette = frames[middle].quantize(128)
        still = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
        still += still[-1:] * HOLD
        still[0].save(DOCS / "replay.gif", save_all=True, append_images=still[1:], duration=100, loop=0, optimize=True)
        opened.set_viewport_size({"width": 1280, "height": 850})
        opened.evaluate(f"corridor.stage.seek({middle})")
        opened.evaluate("scrollTo(0, 0)")
        opened.wait_for_timeout(1000)
        whole = Image.open(io.BytesIO(opened.screenshot())).convert("RGB")
        whole.quantize(192, dither=Image.Dither.NONE).save(DOCS / "page.png", optimize=True)
        chromium.close()


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2] if len(sys.argv) > 2 else None)
