"""The learning curves of ``corridor watch``: values, zoom, axes, smoothing, downloads, by pointer and by keyboard."""

import csv
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import in_each_browser
from page_in_browser import MINUS, PHONE, is_firefox, settle, until
from PIL import Image
from recorded_run import GOLDEN, recorded_run

ROWS = [
    {name: float(text) for name, text in row.items() if text}
    for row in csv.DictReader((GOLDEN / "progress.csv").read_text().splitlines())
]
SUCCESS = "#curves [data-column=success_rate]"
# Randomly, from tiny to huge, and far from zero: the ticks, and what they are called.
RANGES = """() => {
  const found = [];
  let seed = 1;
  const random = () => ((seed = (seed * 48271) % 2147483647) / 2147483647);
  for (let i = 0; i < 3000; i++) {
    const span = 10 ** (random() * 24 - 12);
    const min = (random() - 0.5) * span * 10 ** (random() * 4);
    const ticks = corridor.axes.niceTicks(min, min + span, 8);
    found.push({min, max: min + span, ticks, labels: corridor.axes.tickLabels(ticks)});
  }
  return found;
}"""


@pytest.fixture
def watched(open_page, page_server, tmp_path):
    """Opens the page with one ticked run, whose curves are ``ROWS``."""
    recorded_run(tmp_path / "results", "first")

    def open_one(**options: Any) -> Any:
        opened = open_page(page_server.address, **options)
        drawn(opened, 1)
        return opened

    return open_one


def drawn(opened: Any, runs: int) -> None:
    until(opened, f"corridor.learning?.charts[1].values(0).length === {runs}", 20)
    settle(opened)


def view(opened: Any) -> tuple[float, float]:
    return tuple(opened.evaluate("(({min, max}) => [min, max])(corridor.learning.charts[1].plot.scales.x)"))


def tip(opened: Any, chart: str = SUCCESS) -> tuple[str, dict[str, str]]:
    """Where the cursor is, and each run's value there."""
    lines = [line for line in opened.inner_text(f"{chart} .tip").splitlines() if line.strip()]
    return lines[0], dict(zip(lines[1::2], lines[2::2], strict=True))


def number(label: str) -> float:
    """What a label says, such as -1,000.5, or 3 and a raised power of ten."""
    raised = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
    digits, _, exponent = label.replace(MINUS, "-").replace(",", "").partition("\N{MULTIPLICATION SIGN}10")
    return float(f"{digits}e{exponent.translate(raised) or 0}")


def downloaded(opened: Any, downloads: Path, do: Callable[[], None], name: str) -> Path:
    """The file of that name that the browser downloads when something is done."""
    if is_firefox(opened):  # Playwright hears of nothing that Firefox downloads from a page
        do()
        written, unfinished = downloads / name, downloads / f"{name}.part"
        for _ in range(200):
            if written.is_file() and written.stat().st_size and not unfinished.exists():
                return written
            opened.wait_for_timeout(50)
        raise AssertionError(f"{name} is not among {[path.name for path in downloads.iterdir()]}")
    with opened.expect_download() as download:
        do()
    assert download.value.suggested_filename == name
    saved = downloads / "saved" / name  # not where Firefox's is waited for
    download.value.save_as(saved)
    return saved


def focused(opened: Any, chart: str = SUCCESS) -> None:
    opened.focus(chart)
    settle(opened)


@in_each_browser
def test_the_pointer_shows_the_values_of_the_nearest_row(watched):
    opened = watched()
    opened.hover(f"{SUCCESS} .u-over", position={"x": 120, "y": 20})
    place, values = tip(opened)
    at = int(re.sub(r"\D", "", place))
    row = min(ROWS, key=lambda row: abs(row["env_steps"] - at))
    assert values == {"first": f"{row['success_rate']:.3f}"}
    opened.mouse.move(2, 2)
    assert opened.is_hidden(f"{SUCCESS} .tip")


def test_a_finger_shows_the_values_too(watched):
    opened = watched(viewport=PHONE, has_touch=True, is_mobile=True)
    opened.locator("[data-run=first]").focus()
    places = []
    for left in (120, 60, 120):
        opened.locator(f"{SUCCESS} .u-over").tap(position={"x": left, "y": 20})
        settle(opened)
        place, values = tip(opened)
        assert list(values) == ["first"]
        places.append(int(re.sub(r"\D", "", place)))
    assert places[0] == places[2] == pytest.approx(2 * places[1], rel=0.02)


@in_each_browser
def test_arrows_move_the_cursor_from_row_to_row(watched):
    opened = watched()
    focused(opened)
    for keys, row in (
        (["ArrowRight"], 0),
        (["ArrowRight", "ArrowRight"], 2),
        (["ArrowLeft"], 1),
        (["Shift+ArrowRight"], 11),
        (["End"], -1),
        (["ArrowRight"], -1),
        (["Home"], 0),
    ):
        for key in keys:
            opened.keyboard.press(key)
        expected = ROWS[row]
        assert tip(opened) == (
            f"{expected['env_steps']:,.0f} agent steps",
            {"first": f"{expected['success_rate']:.3f}"},
        )
    opened.keyboard.press("Escape")
    assert opened.is_hidden(f"{SUCCESS} .tip")


@in_each_browser
def test_values_are_said_once_the_keys_are_quiet_and_at_no_other_time(watched):
    opened = watched()
    opened.evaluate(
        "new MutationObserver(() => (window.said = [...(window.said ?? []), document.querySelector('#curve-values')"
        ".textContent])).observe(document.querySelector('#curve-values'), {childList: true})"
    )
    focused(opened)
    for _ in range(6):
        opened.keyboard.press("ArrowRight")
    until(opened, "window.said?.length === 1")
    row = ROWS[5]
    assert opened.evaluate("said") == [
        f"Success rate at {row['env_steps']:,.0f} agent steps: first {row['success_rate']:.3f}."
    ]
    opened.hover(f"{SUCCESS} .u-over", position={"x": 120, "y": 20})
    opened.wait_for_timeout(2500)  # a look at the files, and the pointer, say nothing
    assert opened.evaluate("said.length") == 1
    assert opened.get_attribute("#curve-values", "role") == "status"  # polite


@in_each_browser
def test_dragging_zooms_every_chart_and_a_double_click_shows_everything(watched):
    opened = watched()
    whole = view(opened)
    box = opened.locator(f"{SUCCESS} .u-over").bounding_box()
    begin, end = box["x"] + 0.25 * box["width"], box["x"] + 0.5 * box["width"]
    opened.mouse.move(begin, box["y"] + 40)
    opened.mouse.down()
    opened.mouse.move(end, box["y"] + 60, steps=4)
    opened.mouse.up()
    settle(opened)
    assert view(opened) == pytest.approx((0.25 * whole[1], 0.5 * whole[1]), rel=0.02)
    ranges = opened.evaluate("corridor.learning.charts.map(({plot}) => plot.scales.x.max)")
    assert ranges == [ranges[0]] * 5
    if is_firefox(opened):  # two clicks that Playwright makes in Firefox are never a double one
        opened.dispatch_event(f"{SUCCESS} .u-over", "dblclick")
    else:
        opened.dblclick(f"{SUCCESS} .u-over", position={"x": 50, "y": 50})
    settle(opened)
    assert view(opened) == whole


@in_each_browser
@pytest.mark.parametrize("how", ["keys", "buttons"])
def test_zoom_without_dragging(watched, how):
    opened = watched()
    _, end = view(opened)
    focused(opened)

    def use(key: str, does: str) -> tuple[float, float]:
        if how == "keys":
            opened.keyboard.press(key)
        else:
            opened.click(f"#curve-tools [data-does={does}]")
        settle(opened)
        return view(opened)

    assert use("+", "in") == pytest.approx((0.25 * end, 0.75 * end))
    assert use("+", "in") == pytest.approx((0.375 * end, 0.625 * end))
    if how == "buttons":
        assert use("", "on") == pytest.approx((0.5 * end, 0.75 * end))
        assert use("", "back") == pytest.approx((0.375 * end, 0.625 * end))
    assert use("-", "out") == pytest.approx((0.25 * end, 0.75 * end))
    assert use("0", "all") == (0, end)
    assert use("-", "out") == (0, end)


@in_each_browser
def test_the_cursor_stays_at_its_row_while_the_charts_are_drawn_anew(watched, tmp_path):
    opened = watched()
    focused(opened)
    for key in ("Home", "Shift+ArrowRight", "+", "+"):
        opened.keyboard.press(key)
    settle(opened)
    expected = f"{ROWS[10]['env_steps']:,.0f} agent steps", {"first": f"{ROWS[10]['success_rate']:.3f}"}
    assert tip(opened) == expected
    progress = tmp_path / "results" / "first" / "progress.csv"
    progress.write_text("".join(progress.read_text().splitlines(keepends=True)[:-1]))
    until(opened, f"corridor.learning.charts[1].plot.data[0].length === {len(ROWS) - 1}", 20)
    settle(opened)
    assert tip(opened) == expected


@in_each_browser
def test_the_view_follows_the_cursor_out_of_what_is_shown(watched):
    opened = watched()
    focused(opened)
    for key in ("Home", "+", "+", "+", "End"):
        opened.keyboard.press(key)
    settle(opened)
    low, high = view(opened)
    last = ROWS[-1]
    assert low < last["env_steps"] <= high
    assert tip(opened)[1] == {"first": f"{last['success_rate']:.3f}"}


def test_axis_labels_are_right_and_differ_at_any_range(watched):
    opened = watched()
    for found in json.loads(opened.evaluate(f"JSON.stringify(({RANGES})())")):
        ticks, labels = found["ticks"], found["labels"]
        assert 2 <= len(ticks) <= 9
        assert found["min"] - 1e-9 * abs(found["min"]) <= ticks[0]
        assert len(set(labels)) == len(labels), found
        gap = ticks[1] - ticks[0]
        assert np.abs(np.array([number(label) for label in labels]) - ticks).max() < gap / 100, found


def test_axes_say_what_they_have_in_which_unit_however_deep_the_zoom(watched):
    opened = watched()
    focused(opened)
    titles = []
    for _ in range(12):
        labels = opened.evaluate("corridor.learning.charts[1].labels")
        titles.append(labels["titles"][0])
        factor = {"agent steps": 1, "agent steps, thousands": 1e3, "agent steps, millions": 1e6}[titles[-1]]
        places = [number(label) * factor for label in labels["x"]]
        low, high = view(opened)
        assert len(set(places)) == len(places) >= 1
        assert all(low - 1 <= place <= high + 1 for place in places), (labels, low, high)
        assert len(set(labels["y"])) == len(labels["y"]) > 3
        opened.keyboard.press("+")
        settle(opened)
    assert list(dict.fromkeys(titles)) == ["agent steps, millions", "agent steps, thousands", "agent steps"]
    assert [chart["titles"][1] for chart in opened.evaluate("corridor.learning.charts.map(({labels}) => labels)")] == [
        "mean of 100 episodes",
        "share of 100 episodes",
        "decisions",
        "mean per agent step",
        "agent steps per second",
    ]


def test_against_wall_time(watched):
    opened = watched()
    opened.select_option("#x-axis", "wall_seconds")
    settle(opened)
    assert view(opened) == (0, ROWS[-1]["wall_seconds"])
    assert opened.evaluate("corridor.learning.charts[1].labels.titles[0]") == "wall time, seconds"
    focused(opened)
    opened.keyboard.press("End")
    assert tip(opened) == (f"{ROWS[-1]['wall_seconds']:.0f} s", {"first": f"{ROWS[-1]['success_rate']:.3f}"})
    units = opened.evaluate(
        "[100, 3600, 86400, 1e6].map(span => Object.values(corridor.axes.xUnit('wall_seconds', span)))"
    )
    assert units == [
        ["wall time, seconds", 1],
        ["wall time, minutes", 60],
        ["wall time, hours", 3600],
        ["wall time, days", 86400],
    ]


def test_smoothing_is_the_mean_of_as_many_rows_as_it_says(watched):
    opened = watched()
    opened.select_option("#smoothing", "5")
    focused(opened)
    for row, around in ((0, ROWS[:1]), (1, ROWS[:3]), (2, ROWS[:5]), (3, ROWS[1:6])):  # fewer at the ends
        opened.keyboard.press("ArrowRight")
        mean = np.mean([each["success_rate"] for each in around])
        assert float(tip(opened)[1]["first"]) == pytest.approx(mean, abs=6e-4), row


@in_each_browser
def test_csv_has_the_numbers_that_are_shown(watched, downloads, tmp_path):
    recorded_run(tmp_path / "results" / "penalty", "c0-seed4")
    opened = watched()
    for name in ("first", "penalty/c0-seed4"):
        opened.check(f"[data-run='{name}']")
    drawn(opened, 2)
    focused(opened)
    opened.keyboard.press("+")
    opened.select_option("#smoothing", "5")
    low, high = view(opened)
    written = downloaded(opened, downloads, lambda: opened.click("[data-does=csv]"), "learning-curves.csv")
    rows = list(csv.DictReader(written.read_text().splitlines()))
    expected = [index for index, row in enumerate(ROWS) if low <= row["env_steps"] <= high]
    assert sorted(row["run"] for row in rows) == ["first"] * len(expected) + ["penalty/c0-seed4"] * len(expected)
    for row, index in zip(rows, 2 * expected, strict=True):
        assert float(row["env_steps"]) == ROWS[index]["env_steps"]
        mean = np.mean([each["mean_return"] for each in ROWS[index - 2 : index + 3]])
        assert float(row["mean_return"]) == pytest.approx(mean)
        assert row["mean_of_rows"] == "5"


@in_each_browser
def test_png_is_a_picture_of_all_charts(watched, downloads):
    opened = watched()
    opened.focus("[data-does=png]")
    written = downloaded(opened, downloads, lambda: opened.keyboard.press("Enter"), "learning-curves.png")
    picture = Image.open(written).convert("RGB")
    line = opened.evaluate("getComputedStyle(document.querySelector('#runs .swatch path')).stroke")
    colour = tuple(map(int, re.findall(r"\d+", line)))
    boxes = [(column, row) for row in range(3) for column in range(2)][:5]
    width, height = picture.width // 2, picture.height // 3
    for column, row in boxes:
        part = picture.crop((column * width, row * height, (column + 1) * width, (row + 1) * height))
        assert colour in {pixel for _, pixel in part.getcolors(1 << 24)}
