"""A run is timed from idle device to idle device; all take turns; the facts of the machine can be read again."""

import json
import os
import time
from pathlib import Path

import numpy as np
import pytest
import torch

import lfref
from lfref.bench import timing

CPU = torch.device("cpu")


@pytest.fixture
def clock(monkeypatch):
    """A clock that every run moves on by what it takes."""
    now = [0.0]
    monkeypatch.setattr(time, "perf_counter", lambda: now[0])
    return now


def test_the_clock_runs_from_an_idle_device_to_an_idle_device(monkeypatch, clock):
    events = []

    def wait(device):
        # What is still queued before the run must not count; what the run queued must.
        events.append(("wait", clock[0]))
        clock[0] += 1

    monkeypatch.setattr(timing, "_synchronize", wait)
    assert timing.seconds(lambda: events.append(("run", clock[0])), CPU) == 1
    assert events == [("wait", 0), ("run", 1), ("wait", 1)]


def test_only_a_gpu_is_waited_for(monkeypatch):
    waited = []
    monkeypatch.setattr(torch.cuda, "synchronize", waited.append)
    for device in (CPU, torch.device("cuda", 1)):
        timing.seconds(list, device)
    assert waited == [torch.device("cuda", 1)] * 2


def test_all_take_turns_in_every_round():
    calls = []

    def watch(name, seconds):
        return lambda: calls.append(name) or seconds + len(calls)

    times = timing.in_turns({"a": watch("a", 0.0), "b": watch("b", 0.5)}, range(3), warmup=1)
    assert calls == ["a", "b"] * 3
    assert times == {"a": [3, 5], "b": [4.5, 6.5]}


def test_numpys_fft_is_taken_of_each_channel_in_four_dimensions(monkeypatch, clock):
    channels = []

    def transform(channel):
        channels.append(channel)
        clock[0] += 0.25

    monkeypatch.setattr(np.fft, "fftn", transform)
    views = torch.rand(2, 3, 3, 4, 5)
    assert timing.numpy_fft_time(views) == 0.75
    assert len(channels) == 3
    for channel in range(3):
        np.testing.assert_array_equal(channels[channel], views[:, :, channel].numpy())
        assert channels[channel].flags.c_contiguous


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


def test_the_processor_is_named_with_its_vector_instructions(monkeypatch):
    listing = "processor : 0\nmodel name\t: Some CPU @ 2 GHz\nmodel name\t: Another\n"
    monkeypatch.setattr(Path, "is_file", lambda path: True)
    monkeypatch.setattr(Path, "read_text", lambda path: listing)
    assert timing.processor() == f"Some CPU @ 2 GHz ({torch.backends.cpu.get_cpu_capability()})"
