"""What packages and all that they need take on disk: ``python -m trainer.bench.peers.install_size NAME...``.

It prints the version of the first and the bytes. The interpreter may be as old as Python 3.10; nothing is imported.
"""

import json
import re
import sys
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

# A requirement as metadata has it: name, extras and whatever follows, such as ``pkg[a,b]>=1; extra == "c"``.
REQUIREMENT = re.compile(r"\s*([A-Za-z0-9._-]+)\s*(?:\[([^\]]*)\])?(.*)", re.DOTALL)
OF_EXTRA = re.compile(r"""extra\s*==\s*['"]([^'"]+)['"]""")


def needed(requirements: list[str]) -> dict[str, Distribution]:
    """The distributions of these requirements and of all that they require, as far as they are installed, by name."""
    found: dict[str, Distribution] = {}
    seen: set[tuple[str, str]] = set()
    waiting = list(requirements)
    while waiting:
        matched = REQUIREMENT.match(waiting.pop())
        assert matched is not None
        name = re.sub(r"[-_.]+", "-", matched[1]).lower()
        try:
            found.setdefault(name, distribution(name))
        except PackageNotFoundError:  # for another system, or another Python
            continue
        for extra in ["", *filter(None, map(str.strip, (matched[2] or "").split(",")))]:
            if (name, extra) in seen:
                continue
            seen.add((name, extra))
            for each in found[name].requires or []:
                of_extra = OF_EXTRA.search(each)
                if (of_extra[1] if of_extra else "") == extra:
                    waiting.append(each)
    return found


def size(of: Distribution) -> int:
    """Of its files, in bytes."""
    paths = [Path(str(each.locate())) for each in of.files or []]
    return sum(path.stat().st_size for path in paths if path.is_file())


def main(requirements: list[str]) -> None:
    """Prints what was asked for."""
    found = needed(requirements)
    version = found[next(iter(found))].version if found else None
    print(json.dumps({"version": version, "bytes": sum(map(size, found.values()))}))


if __name__ == "__main__":
    main(sys.argv[1:])
