"""A run is timed from idle device to idle device; all take turns; the facts of the machine can be read again."""

import json
from importlib import metadata

import torch

import lfref
from lfref.bench import timing


def test_all_take_turns_in_every_round():
    calls = []

    def watch(name, seconds):
        return lambda: calls.append(name) or seconds + len(calls)

    times = timing.in_turns({"a": watch("a", 0.0), "b": watch("b", 0.5)}, range(3), warmup=1)
    assert calls == ["a", "b"] * 3
    assert times == {"a": [3, 5], "b": [4.5, 6.5]}


def test_facts_name_libraries_and_threads():
    facts = timing.facts(torch.device("cpu"))
    assert facts["threads"] == torch.get_num_threads()
    assert (facts["lfref"], facts["torch"]) == (lfref.__version__, metadata.version("torch"))
    assert json.loads(json.dumps(facts)) == facts
