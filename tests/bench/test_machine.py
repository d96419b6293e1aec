"""What a measurement was made on can be written down and read again."""

import json
import os
from pathlib import Path

import numpy as np
import torch

import lfref
from lfref.bench import timing


def test_facts_name_machine_libraries_and_threads():
    facts = timing.facts(torch.device("cpu"))
    assert facts["device"] == "CPU"
    assert facts["cores"] == os.cpu_count()
    assert facts["threads"] == torch.get_num_threads()
    assert str(facts["torch"]).split("+")[0] == torch.__version__.split("+")[0]
    assert facts["lfref"] == lfref.__version__
    assert {"processor", "system", "python", *timing.PACKAGES} <= facts.keys()
    assert json.loads(json.dumps(facts)) == facts


def test_a_package_that_is_not_installed_has_no_version():
    assert timing.version("numpy") == np.__version__
    assert timing.version("no-such-package") is None


def test_a_gpu_is_called_by_its_name(monkeypatch):
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda device: f"card {device.index}")
    assert timing.facts(torch.device("cuda", 1))["device"] == "card 1"


def test_the_processor_is_named_with_its_vector_instructions(monkeypatch):
    listing = "processor : 0\nmodel name\t: Some CPU @ 2 GHz\nmodel name\t: Another\n"
    monkeypatch.setattr(Path, "is_file", lambda path: True)
    monkeypatch.setattr(Path, "read_text", lambda path: listing)
    assert timing.processor() == f"Some CPU @ 2 GHz ({torch.backends.cpu.get_cpu_capability()})"


def test_without_a_listing_the_platform_is_asked(monkeypatch):
    monkeypatch.setattr(Path, "is_file", lambda path: False)
    monkeypatch.setattr("platform.processor", lambda: "arm")
    assert timing.processor().startswith("arm (")
