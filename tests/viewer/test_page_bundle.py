"""The page's one file is what its sources make."""

import shutil
import subprocess

import pytest

from trainer.viewer.document import PAGE


@pytest.mark.slow
def test_the_bundle_is_built_from_its_sources(tmp_path):
    if shutil.which("npm") is None:
        pytest.skip("Node is not installed")
    sources = tmp_path / "page"
    shutil.copytree(PAGE.parent, sources, ignore=shutil.ignore_patterns("node_modules"))
    installed = subprocess.run(["npm", "ci", "--ignore-scripts"], cwd=sources, capture_output=True, text=True)
    if installed.returncode:
        pytest.skip(f"npm can't install the bundler: {installed.stderr[-200:]}")
    subprocess.run(["npm", "run", "build"], cwd=sources, check=True, capture_output=True)
    assert (sources / "page.html").read_bytes() == PAGE.read_bytes(), "run 'make page'"
