"""A run is timed from idle device to idle device; all take turns; the facts of the machine can be read again."""

import json
import os

import torch

import lfref
from lfref.bench import timing

CPU = torch.device("cpu")


def test_all_take_turns_in_every_round():
    calls = []

    def watch(name, seconds):
        return lambda: calls.append(name) or seconds + len(calls)

    times = timing.in_turns({"a": watch("a", 0.0), "b": watch("b", 0.5)}, range(3), warmup=1)
    assert calls == ["a", "b"] * 3
    assert times == {"a": [3, 5], "b": [4.5, 6.5]}


def test_facts_name_machine_libraries_and_threads():
    facts = timing.facts(torch.device("cpu"))
    assert facts["device"] == "CPU"
    assert facts["cores"] == os.cpu_count()
    assert facts["threads"] == torch.get_num_threads()
    assert str(facts["torch"]).split("+")[0] == torch.__version__.split("+")[0]
    assert facts["lfref"] == lfref.__version__
    assert {"processor", "system", "python", *timing.PACKAGES} <= facts.keys()
    assert json.loads(json.dumps(facts)) == facts
