"""What axe-core, the accessibility checker, finds on a page as it is shown now."""

import json
from pathlib import Path
from typing import Any

import pytest

import trainer.viewer

AXE = Path(trainer.viewer.__file__).parent / "page" / "node_modules" / "axe-core" / "axe.min.js"


def violations(opened: Any) -> list[str]:
    """Every violation with the elements that have it, one a line; empty if there is none.

    Args:
        opened: A Playwright page.
    """
    if not AXE.is_file():
        pytest.skip(f"axe-core is not in {AXE.parents[1]}: run 'make page', which installs it")
    if not opened.evaluate("'axe' in window"):
        opened.add_script_tag(content=AXE.read_text(encoding="utf-8"))
    found = opened.evaluate("axe.run(document, {resultTypes: ['violations']}).then(found => JSON.stringify(found))")
    return [
        f"{violation['id']}: {violation['help']}: {node['html'][:200]} ({node.get('failureSummary', '')})"
        for violation in json.loads(found)["violations"]
        for node in violation["nodes"]
    ]
