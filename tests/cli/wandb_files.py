"""Reads the files that wandb writes offline: blocks of 32 KiB with records in parts, as LevelDB's log has them."""

import json
import struct
import time
from pathlib import Path

from wandb.proto import wandb_internal_pb2

BLOCK, FILE_HEADER, PART_HEADER = 32768, 7, 7
WHOLE, FIRST, MIDDLE, LAST = 1, 2, 3, 4
LIMIT_S = 60


def records(path: Path) -> list:
    """The records of a finished run, in order."""
    start_s = time.monotonic()
    while time.monotonic() - start_s < LIMIT_S:
        found = list(_written(path))
        if any(record.WhichOneof("record_type") == "exit" for record in found):
            return found
        time.sleep(0.1)  # wandb's own process closes the file after `finish` has returned
    raise AssertionError(f"{path} has no record of the run's end")


def _written(path: Path):
    """The records that are in a file so far."""
    contents, at, parts = path.read_bytes(), FILE_HEADER, b""
    while at + PART_HEADER <= len(contents):
        if BLOCK - at % BLOCK < PART_HEADER:  # too short for another header: filled with zeros
            at += BLOCK - at % BLOCK
            continue
        _, length, kind = struct.unpack("<IHB", contents[at : at + PART_HEADER])
        part = contents[at + PART_HEADER : at + PART_HEADER + length]
        if len(part) < length:
            return
        at += PART_HEADER + length
        parts = part if kind in (WHOLE, FIRST) else parts + part
        if kind in (WHOLE, LAST):
            record = wandb_internal_pb2.Record()
            record.ParseFromString(parts)
            yield record


def offline_files(folder: Path) -> list[Path]:
    """The files of the runs in a run folder, oldest first."""
    return sorted(folder.glob("wandb/offline-run-*/run-*.wandb"), key=lambda path: path.stat().st_mtime)


def run_of(path: Path):
    """The record of the run itself."""
    return next(record.run for record in records(path) if record.WhichOneof("record_type") == "run")


def config_of(path: Path) -> dict:
    """The configuration that was logged."""
    found = {}
    for record in records(path):
        updates = {"run": record.run.config.update, "config": record.config.update}
        for item in updates.get(record.WhichOneof("record_type"), ()):
            found[item.key or ".".join(item.nested_key)] = json.loads(item.value_json)
    return found


def history_of(path: Path) -> list[dict]:
    """The logged values, one dictionary for each call."""
    return [
        {item.key or "/".join(item.nested_key): json.loads(item.value_json) for item in record.history.item}
        for record in records(path)
        if record.WhichOneof("record_type") == "history"
    ]


def artifacts_of(path: Path) -> list:
    """The artifacts that were logged."""
    logged = [record.request.log_artifact.artifact for record in records(path)]
    return [each for each in [*logged, *(record.artifact for record in records(path))] if each.type]
