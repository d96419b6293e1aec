"""Types of the page's program, which its comments declare, by TypeScript's compiler where there is one."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

import lfref.viewer
from lfref.viewer import view_page

TSC = shutil.which("tsc", path=os.environ.get("NODE_MODULES", "node_modules") + "/.bin") or shutil.which("tsc")
STRICT = ("--checkJs", "--allowJs", "--noEmit", "--strict", "--target", "es2023", "--lib", "es2023,dom,dom.iterable")


@pytest.mark.skipif(TSC is None, reason="needs tsc in the folder NODE_MODULES (npm install typescript), or on the path")
def test_types_hold():
    checked = [TSC, *STRICT, *view_page.PROGRAMS]
    done = subprocess.run(checked, cwd=Path(lfref.viewer.__file__).parent, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
