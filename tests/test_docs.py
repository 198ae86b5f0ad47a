"""The documents: their links lead somewhere, the paths that they name exist, and no page is too long to be read."""

import functools
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
WINGS = ("corridor_server", "trainer", "tests", "docs", "docker", "proto")
PAGES = sorted([*ROOT.glob("*.md"), *(path for wing in WINGS for path in (ROOT / wing).rglob("*.md"))])
PAGES = [page for page in PAGES if "node_modules" not in page.parts]
PUBLIC = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
MOST_WORDS = 2500

FENCE = re.compile(r"^```.*?^```$", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"\]\(([^)\s]+)\)")
# What a run writes, what a user has, and what only looks like a path.
NOT_OURS = re.compile(r"(results|checkpoints|tensorboard|run_logs|path|Corridor)/|n/a$|s3://|[^/]*<")
IN_THE_REPOSITORY = re.compile(rf"(?<![\w/.<>:-])(?:{'|'.join(WINGS)})/[\w./-]*")


def name(page: Path) -> str:
    return str(page.relative_to(ROOT))


@functools.cache
def anchors(page: Path) -> set[str]:
    """What GitHub makes of a page's headings."""
    headings = re.findall(r"^#+ (.+)$", FENCE.sub("", page.read_text(encoding="utf-8")), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_every_link_leads_somewhere(page):
    broken = []
    for link in LINK.findall(FENCE.sub("", page.read_text(encoding="utf-8"))):
        if re.match(r"\w+:", link):
            continue  # another site
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        if not target.exists() or (anchor and anchor not in anchors(target)):
            broken.append(link)
    assert not broken


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_every_path_in_code_exists(page):
    spans = re.findall(r"`([^`\s]+/[^`\s]*)`", FENCE.sub("", page.read_text(encoding="utf-8")))
    ours = [span for span in spans if not NOT_OURS.match(span)]
    assert [path for path in ours if not (ROOT / path).exists() and not (page.parent / path).exists()] == []


def test_every_file_of_the_repository_that_is_spoken_of_exists():
    """In commands and comments too, wherever a path begins with one of the repository's folders and names a file."""
    sources = [path for wing in WINGS for end in ("py", "sh", "ts", "yaml") for path in (ROOT / wing).rglob(f"*.{end}")]
    sources = [path for path in sources if "node_modules" not in path.parts]
    missing = []
    for source in [*PAGES, *sources, ROOT / "Makefile", ROOT / "pyproject.toml"]:
        for path in IN_THE_REPOSITORY.findall(source.read_text(encoding="utf-8")):
            path = path.rstrip(".")
            if Path(path).suffix and not (ROOT / path).exists():
                missing.append((name(source), path))
    assert missing == []


@pytest.mark.parametrize("page", PUBLIC, ids=name)
def test_a_page_is_read_in_one_sitting(page):
    assert len(page.read_text(encoding="utf-8").split()) <= MOST_WORDS


def test_the_tests_page_has_every_test_file():
    table = (ROOT / "tests/README.md").read_text(encoding="utf-8").split("## ")[0]
    listed = re.findall(r"`(test_\w+\.py)`", table)
    assert sorted(set(listed)) == sorted(path.name for path in (ROOT / "tests").rglob("test_*.py"))


def test_the_tests_that_stand_for_the_protocol_exist():
    """Each line of the protocol names a test by a part of its name: the kit's, or one file's."""
    text = (ROOT / "tests/README.md").read_text(encoding="utf-8").split("## The protocol")[1]
    kit = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "trainer/conformance").glob("*.py"))
    files = {path.stem: path for path in (ROOT / "tests").rglob("test_*.py")}
    rows = [line.split(" | ")[1] for line in text.splitlines() if line.startswith("| ") and " | " in line][1:]
    assert len(rows) > 30
    missing = []
    for span in re.findall(r"`(\w+(?:: \w+)?)`", "\n".join(rows)):
        file, _, part = span.rpartition(": ")
        if file:
            beside = [path.read_text(encoding="utf-8") for path in files[file].parent.glob("*.py")]
            known = any(re.search(rf"def \w*{part}", text) for text in beside)
        elif span.startswith("test_"):
            known = span in files
        else:
            known = re.search(rf"def \w*{span}|\b{span}\b", kit) is not None
        if not known:
            missing.append(span)
    assert missing == []
