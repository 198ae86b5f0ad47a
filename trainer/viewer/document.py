"""The page (``trainer/viewer/page/``, built into one file) with something to show."""

import json
from pathlib import Path
from typing import Any

PAGE = Path(__file__).parent / "page" / "page.html"
_DATA = "/* data */"


def page(data: dict[str, Any]) -> str:
    """The page as one HTML document that needs no network.

    Args:
        data: ``PageData`` of ``trainer/viewer/page/src/data.ts``.
    """
    # A "<" in a name must not end the script element that holds the data.
    text = json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    before, after = PAGE.read_text(encoding="utf-8").split(_DATA)
    return f"{before}{text}{after}"
