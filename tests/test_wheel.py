"""What is installed from a wheel works from anywhere, without the checkout."""

import os
import subprocess
import sys
import zipfile

import pytest

from tests.conftest import ROOT

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Folder that the wheel was unpacked into."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", str(folder), str(ROOT)]
    subprocess.run(build, check=True, capture_output=True)
    (wheel,) = folder.glob("*.whl")
    zipfile.ZipFile(wheel).extractall(folder / "site")
    return folder / "site"


def test_the_wheel_holds_configuration_sweeps_and_page(installed):
    for name in ("conf/train.yaml", "conf/hydra/help/train.yaml", "sweeps/blocks.yaml", "report/page.css", "py.typed"):
        assert (installed / "lfref" / name).is_file()
    assert not (installed / "tests").exists()


def run(installed, folder, *words) -> subprocess.CompletedProcess:
    environment = os.environ | {"PYTHONPATH": str(installed)}
    return subprocess.run([sys.executable, *words], cwd=folder, env=environment, capture_output=True, text=True)


def test_commands_find_configuration_and_sweeps_from_any_folder(installed, tmp_path):
    assert run(installed, tmp_path, "-c", "import lfref; print(lfref.__file__)").stdout.startswith(str(installed))
    shown = run(installed, tmp_path, "-m", "lfref.cli.main", "train", "--cfg", "job").stdout
    assert "_target_: lfref.nets.refnet.RefNet" in shown
    refused = run(installed, tmp_path, "-m", "lfref.cli.main", "train", "-m", "+sweep=magic")
    assert refused.returncode == 2
    assert "activation, beta_gamma, blocks, normalization" in refused.stderr
