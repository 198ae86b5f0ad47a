"""The page for everybody: by keyboard alone, by ear, in few colours, on narrow screens, and on paper."""

from pathlib import Path
from typing import Any

import pytest
from axe import violations
from conftest import in_each_browser
from eventful import eventful
from page_in_browser import PHONE, at, choose, differing, pixels, settle, shown, until
from recorded_run import begun_run
from test_colours import contrast

from trainer.runs.trajectories import save_trajectories
from trainer.viewer.corridor_scene import run_scene
from trainer.viewer.document import page

WIDTHS = (320, 360, 390, 480, 639, 640, 641, 768, 899, 900, 901, 1024, 1280, 1920)
# Every visible element that has text of its own, with its colour and what is behind it, as red, green and blue.
TEXTS = """(() => {
    const canvas = Object.assign(document.createElement('canvas'), {width: 1, height: 1});
    const g = canvas.getContext('2d', {willReadFrequently: true});
    const over = (layers) => {
        g.clearRect(0, 0, 1, 1);
        for (const layer of layers) { g.fillStyle = layer; g.fillRect(0, 0, 1, 1); }
        return [...g.getImageData(0, 0, 1, 1).data].slice(0, 3);
    };
    const found = new Map();
    for (const element of document.querySelectorAll('body *')) {
        const own = [...element.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim());
        if (!own || !element.checkVisibility() || element.matches('script, .unseen *')) continue;
        const layers = [];
        for (let at = element; at; at = at.parentElement) layers.unshift(getComputedStyle(at).backgroundColor);
        const pair = [over([...layers, getComputedStyle(element).color]), over(layers)];
        found.set(JSON.stringify(pair), element.textContent.trim().slice(0, 40));
    }
    return [...found].map(([pair, text]) => [...JSON.parse(pair), text]);
})()"""


@pytest.fixture(scope="module")
def replay(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("page") / "replay.html"
    path.write_text(page({"mode": "replay", "scene": run_scene(*eventful())}), encoding="utf-8")
    return path.as_uri()


@pytest.fixture
def watched(page_server: Any, tmp_path: Path) -> str:
    """The address of a watcher of two evaluated runs."""
    for run_id, haste in (("slow", 0.6), ("quick", 1.0)):
        config, trajectories = eventful(run_id, haste)
        save_trajectories(begun_run(config, tmp_path / "results").trajectories, trajectories)
    return page_server.address


def hexadecimal(colour: list[int]) -> str:
    return "#" + bytes(colour).hex()


def check(opened: Any) -> None:
    """No violation, and text of every colour stands out from what is behind it."""
    assert violations(opened) == []
    pairs = opened.evaluate(TEXTS)
    assert pairs
    weak = [(text, contrast(hexadecimal(one), hexadecimal(other))) for one, other, text in pairs]
    assert [(text, ratio) for text, ratio in weak if ratio < 4.5] == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_nothing_keeps_anybody_out(open_page, replay, watched, scheme):
    opened = open_page(replay, color_scheme=scheme, in_3d=True)
    choose(opened, 0)
    at(opened, 40)
    check(opened)
    opened = open_page(
        f"{watched}#run=slow&episode=0&t=3&beside=quick", color_scheme=scheme, viewport=PHONE, in_3d=True
    )
    until(opened, "corridor.stage.beside !== null")
    check(opened)
    opened.click("[data-tab=drive]")
    until(opened, "document.querySelector('#drive-result').innerText.includes('first move')")
    check(opened)
    check(open_page(watched.partition("?")[0], color_scheme=scheme, in_3d=True))


@in_each_browser
def test_space_plays_wherever_the_focus_is_but_where_it_has_a_use(open_page, replay):
    opened = open_page(replay)
    choose(opened, 1)
    playing = "corridor.stage.isPlaying"
    for selector in ("#episode-list [tabindex='0']", "#scrub", "body"):
        opened.evaluate(f"document.activeElement.blur(); document.querySelector({selector!r}).focus()")
        for expected in (True, False):
            opened.keyboard.press("Space")
            assert opened.evaluate(playing) == expected, selector
    assert opened.evaluate("scrollY") == 0
    opened.focus("#loop")
    opened.keyboard.press("Space")
    assert opened.get_attribute("#loop", "aria-pressed") == "true"
    opened.focus("[data-filter=failures]")
    opened.keyboard.press("Space")
    assert opened.get_attribute("[data-filter=failures]", "aria-pressed") == "true"
    opened.focus("#speed")
    opened.keyboard.press("Space")
    opened.keyboard.press("Escape")
    assert not opened.evaluate(playing)
    opened.focus("#play")
    opened.keyboard.press("Space")
    assert opened.evaluate(playing)


@in_each_browser
def test_the_slider_speaks_time_and_keeps_its_own_keys(open_page, replay):
    last = len(eventful()[1].episodes[0].rewards)
    opened = open_page(replay)
    choose(opened, 0)
    opened.focus("#scrub")
    for key, row in (("Home", 0), ("ArrowRight", 1), ("ArrowUp", 2), ("Shift+ArrowRight", 12), ("End", last)):
        opened.keyboard.press(key)
        settle(opened)
        ending = ", failed" if row == last else ""
        said = f"{row / 10:.1f} of {last / 10:.1f} seconds{ending}"
        assert opened.get_attribute("#scrub", "aria-valuetext") == said, key
    assert opened.evaluate("corridor.list.onStage") == 0  # its up and down are not the list's


@in_each_browser
def test_tabs_are_one_stop_with_arrows_between_them(open_page, watched):
    opened = open_page(watched)
    until(opened, "document.querySelector('#runs li')")
    names = ["learning", "episodes", "drive"]
    opened.focus("#tab-learning")
    for key, name in (("ArrowRight", "episodes"), ("ArrowRight", "drive"), ("ArrowRight", "learning"), ("End", "drive"),
                      ("ArrowLeft", "episodes"), ("Home", "learning"), ("ArrowLeft", "drive")):  # fmt: skip
        opened.keyboard.press(key)
        assert opened.evaluate("document.activeElement.id") == f"tab-{name}"
        for each in names:
            tab, panel = opened.locator(f"#tab-{each}"), opened.locator(f"#{each}")
            assert tab.get_attribute("aria-selected") == str(each == name).lower()
            assert tab.get_attribute("tabindex") == ("0" if each == name else "-1")
            assert tab.get_attribute("aria-controls") == each
            assert panel.get_attribute("role") == "tabpanel"
            assert panel.get_attribute("aria-labelledby") == f"tab-{each}"
            assert panel.is_visible() == (each == name)
    opened.keyboard.press("Enter")  # whoever presses it wants to drive
    assert opened.evaluate("document.activeElement.id") == "joystick"


@pytest.mark.slow
def test_focus_survives_every_update_and_nothing_chatters(open_page, watched, tmp_path):
    opened = open_page(f"{watched}#run=slow&episode=1&t=1")
    shown(opened, 1)
    opened.select_option("#speed", "8")
    opened.evaluate(
        """(() => {
            window.heard = [];
            const live = '[role=status], [role=alert], [role=log], [aria-live], output';
            for (const region of document.querySelectorAll(live))
                new MutationObserver(() => heard.push(region.id + ': ' + region.textContent))
                    .observe(region, {childList: true, characterData: true, subtree: true});
        })()"""
    )
    stops = [
        "#tab-episodes",
        "#episode-run",
        "#beside-run",
        "[data-filter=all]",
        "#episode-list [tabindex='0']",
        "#scrub",
    ]
    for number, selector in enumerate(stops):
        opened.focus(selector)
        opened.evaluate("window.focused = document.activeElement")
        config, trajectories = eventful(f"more{number}")
        save_trajectories(begun_run(config, tmp_path / "results").trajectories, trajectories)
        until(opened, f"document.querySelector('#episode-run').options.length === {number + 3}")
        assert opened.evaluate("document.activeElement === focused && focused.isConnected"), selector
    assert opened.evaluate("heard") == []
    opened.keyboard.press("Space")
    until(opened, "!corridor.stage.isPlaying && corridor.stage.time === corridor.stage.end")
    assert opened.evaluate("heard") == ["spoken: failed, the episode is over."]


def test_every_picture_has_a_name(open_page, replay):
    opened = open_page(replay)
    choose(opened, 0)
    named = "all => all.map(c => [c.getAttribute('role'), (c.getAttribute('aria-label') ?? '').length > 10])"
    assert opened.eval_on_selector_all("canvas", named) == [["img", True]] * opened.locator("canvas").count()
    assert opened.locator("canvas").count() == 8


@pytest.mark.parametrize("media", [{"forced_colors": "active"}, {"media": "print"}], ids=["forced", "print"])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_marks_stay_in_forced_colours_and_on_paper(open_page, replay, media, scheme):
    opened = open_page(replay, color_scheme=scheme)
    choose(opened, 0)
    opened.emulate_media(**media)
    settle(opened)
    for selector in ("#marks .at-contact", "#marks .at-end", "#mark-legend .at-contact"):
        style = f"getComputedStyle(document.querySelector('{selector}'))"
        colour, *kept = opened.evaluate(
            f"[{style}.backgroundColor, {style}.forcedColorAdjust, {style}.printColorAdjust]"
        )
        assert kept[0 if "forced_colors" in media else 1] in ("none", "exact")
        assert colour not in ("rgba(0, 0, 0, 0)", opened.evaluate("getComputedStyle(document.body).backgroundColor"))
    strip = pixels(opened.locator("#marks").screenshot())
    assert (abs(strip - strip[0, 0]).max(axis=-1) > 60).mean() > 0.005
    assert opened.is_visible("#mark-legend")
    assert opened.is_visible("#play") == ("media" not in media)


def test_without_scripts_it_says_what_it_is(open_page, replay):
    opened = open_page(replay, java_script_enabled=False)
    assert "draws with JavaScript, which is switched off" in opened.locator("body").inner_text()


@in_each_browser
def test_nothing_scrolls_sideways_at_any_width(open_page, watched):
    opened = open_page(f"{watched}#run=slow&episode=0&t=3")
    shown(opened, 0)

    def fits(what: str) -> None:
        for width in WIDTHS:
            opened.set_viewport_size({"width": width, "height": 800})
            try:  # once the charts have followed
                until(opened, f"innerWidth === {width} && document.documentElement.scrollWidth <= {width}", 10)
            except AssertionError:
                raise AssertionError(f"{what} is wider than {width} px") from None

    fits("an episode")
    opened.select_option("#beside-run", "quick")
    until(opened, "corridor.stage.beside !== null")
    fits("two runs")
    opened.click("[data-tab=drive]")
    until(opened, "document.querySelector('#drive-result').innerText.includes('first move')")
    fits("driving")


@in_each_browser
def test_wheel_and_finger_scroll_the_page_past_the_3d_view(open_page, replay, browser):
    opened = open_page(replay, viewport={"width": 390, "height": 500}, has_touch=True, in_3d=True)
    choose(opened, 0)
    opened.evaluate("scrollTo(0, 0)")
    canvas = opened.locator("#canvas3d")
    before = pixels(canvas.screenshot())
    box = canvas.bounding_box()
    middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    opened.mouse.move(*middle)
    opened.mouse.wheel(0, 150)
    until(opened, "scrollY >= 100")
    opened.evaluate("scrollTo(0, 0)")
    settle(opened)
    assert differing(pixels(canvas.screenshot()), before) < 0.001
    opened.keyboard.down("Control")
    opened.mouse.wheel(0, -300)
    opened.keyboard.up("Control")
    opened.wait_for_timeout(100)
    settle(opened)
    assert opened.evaluate("scrollY") == 0
    zoomed = pixels(canvas.screenshot())
    assert differing(zoomed, before) > 0.02
    if browser.browser_type.name != "chromium":
        return  # Playwright moves a finger in Chromium alone
    touch = opened.context.new_cdp_session(opened)
    for step in range(10):
        kind = "touchStart" if step == 0 else "touchMove"
        touch.send(
            "Input.dispatchTouchEvent", {"type": kind, "touchPoints": [{"x": middle[0], "y": middle[1] - 15 * step}]}
        )
    touch.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    until(opened, "scrollY >= 100")
    opened.evaluate("scrollTo(0, 0)")
    settle(opened)
    assert differing(pixels(canvas.screenshot()), zoomed) < 0.001
