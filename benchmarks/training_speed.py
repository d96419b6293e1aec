"""What options of `lfref train` do to the time of a step: precision, memory layout, compiling.

`python benchmarks/training_speed.py` takes turns with the options, on a GPU if there is one, and leaves tables in
`runs/figures/training_speed`. `measure.py training_speed training_speed_gpu` puts them into the page on scaling.
"""

import functools
import json
from collections.abc import Callable, Iterator, Sequence

import markers
import pandas as pd
import torch
import torch._dynamo
import torch._inductor.config
from hydra import compose, initialize_config_dir

from lfref.bench import timing
from lfref.cli import config as configs
from lfref.cli import train
from lfref.report import tables

RUN = markers.ROOT / "runs" / "figures" / "training_speed"
NETWORKS = {
    "cpu": ("refnet_small",),
    "cuda": ("refnet",),
}
"""By the device: a processor takes minutes for a step of the whole RefNet."""
PLAIN = "as it is"
OPTIONS: dict[str, tuple[str, ...]] = {
    PLAIN: (),
    "`channels_last=true`": ("channels_last=true",),
    "`compile=true`": ("compile=true",),
    "both": ("channels_last=true", "compile=true"),
    "`trainer.precision=bf16-mixed`": ("trainer.precision=bf16-mixed",),
    "bf16-mixed and both": ("trainer.precision=bf16-mixed", "channels_last=true", "compile=true"),
}
BATCH, ROUNDS = 4, 12
PATCH = {"cpu": 64, "cuda": 192}
"""Height and width of the crops in pixels, by the device; the paper's on a GPU."""


def step(overrides: Sequence[str], device: torch.device) -> Callable[[], None]:
    """A step of a training: loss, gradients and optimiser, on random views."""
    config = compose("train", list(overrides))
    module = train.build_module(config, configs.build(config.data)).to(device)
    optimizer = module.configure_optimizers()["optimizer"]
    patch = PATCH[device.type]
    views = torch.rand(BATCH, 7, 7, 3, patch, patch, device=device)
    labels = torch.rand(BATCH, len(module.planes), 3, patch, patch, device=device)
    is_half = "bf16" in str(config.trainer.precision)

    def run() -> None:
        with torch.autocast(device.type, torch.bfloat16, enabled=is_half):
            loss = module.loss(module.net(views), labels)
        loss.backward()
        optimizer.step()
        optimizer.zero_grad()

    return run


def measure(device: torch.device) -> pd.DataFrame:
    """Median seconds of a step, and those of the first one, which compiles."""
    # All networks share the code of their class, of which PyTorch compiles 8 variants and then silently stops.
    networks = NETWORKS[device.type]
    torch._dynamo.config.recompile_limit = len(networks) * len(OPTIONS) + 8
    rows = []
    torch._inductor.config.force_disable_caches = True  # else a second run would compile nothing
    with initialize_config_dir(str(configs.directory()), version_base="1.3"):
        for network in networks:
            steps = {name: step([f"net={network}", *words], device) for name, words in OPTIONS.items()}
            first_s = {name: timing.seconds(run, device) for name, run in steps.items()}
            watches = {name: functools.partial(timing.seconds, run, device) for name, run in steps.items()}
            spent = timing.in_turns(watches, range(ROUNDS), 2)
            for name, times in spent.items():
                row = {"network": network, "options": name, "device": device.type}
                rows.append(row | {"step_s": pd.Series(times).median(), "first_s": first_s[name]})
    return pd.DataFrame(rows)


def table(device: str) -> Iterator[str]:
    """Steps of each network on the `cpu` or `cuda` relative to the plain one, measured in the same turns."""
    rows = tables.read_table(RUN / f"{device}.csv")
    facts = json.loads((RUN / f"{device}.json").read_text())
    networks = list(NETWORKS[device])
    steps = rows.pivot(index="options", columns="network", values="step_s")
    yield f"| time of a step | {' | '.join(f'`net={name}`' for name in networks)} | first step, s |"
    yield f"|---|{'---|' * (len(networks) + 1)}"
    for options, row in steps.loc[list(OPTIONS), networks].iterrows():
        if options == PLAIN:
            cells = [f"{seconds:.2g} s" for seconds in row]
        else:
            cells = [f"{ratio:.2f} x" for ratio in row / steps.loc[PLAIN, networks]]
        first_s = rows.loc[rows["options"] == options, "first_s"].max()
        yield f"| {options} | {' | '.join(cells)} | {first_s:.0f} |"
    yield ""
    yield f"Loss, gradients and optimiser on {BATCH} crops of {PATCH[device]} pixels of 7x7 views, the paper's planes,"
    yield f"median of {ROUNDS} rounds taken in turns; {facts['device']}, torch {facts['torch']},"
    yield f"{facts['processor']}, {facts['threads']} threads."


TABLES = {
    name: functools.partial(table, device)
    for name, device in (("training_speed", "cpu"), ("training_speed_gpu", "cuda"))
    if (RUN / f"{device}.json").is_file()
}


def main() -> None:
    """Measure the steps, and keep them with what is known of the machine."""
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    rows = measure(device)
    RUN.mkdir(parents=True, exist_ok=True)
    tables.write_table(RUN / f"{device.type}.csv", rows)
    (RUN / f"{device.type}.json").write_text(json.dumps(timing.facts(device)))


if __name__ == "__main__":
    main()
