"""A multirun of `lfref train` as an ablation: one row for each variant, its seeds, and differences from a reference.

A variant is the jobs that differ in nothing but the seed. Differences are paired: variant less reference, seed by seed.
The interval of n values with mean m and standard deviation s is m ± t s / √n, where t is the quantile of Student's
distribution with n - 1 degrees of freedom (Student, "The probable error of a mean", Biometrika 6, 1908).
"""

import functools
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
import torch
import yaml
from scipy import stats

from lfref.bench import timing
from lfref.errors import InputError, LfrefError, counted
from lfref.io import run as runs
from lfref.io.run import Run
from lfref.refocuser.load import load
from lfref.refocuser.networks import NetworkRefocuser
from lfref.report import plots, tables
from lfref.report.page import Section

LEVEL = 0.95
"""Probability that an interval covers the mean."""
PLACES = (*runs.FOLDERS, "overwrite", "hydra", "logger")
"""First names of keys that change no result."""
SEED = "seed"
ROUNDS = 6
"""Rounds of the measurement of time, of which the first is a warm-up."""
Variant = tuple[str, ...]
"""Values of the keys that vary."""


@dataclass(frozen=True)
class Options:
    """How a sweep is shown."""

    reference: Variant | None = None
    """Values of the reference row, in the order of the columns; None: the default values, else the first row."""
    measures_time: bool = False
    """Whether to measure the time that each variant takes for a stack."""
    defaults: Callable[[Sequence[str]], Mapping[str, str]] = lambda overrides: {}
    """(overrides of all jobs) -> key -> its default value as text; empty if the defaults are unknown."""


@dataclass(frozen=True)
class Job:
    """A job of a sweep."""

    run: Run
    settings: Mapping[str, str]
    """Key -> value as text, of every override that may change the result."""
    config: Mapping[str, str]
    """Key -> value as text, of the whole configuration; empty if the job did not get so far."""
    validations: pd.DataFrame
    """Lines of the log with a validation; columns `step`, `val/mpsnr` and those of other metrics."""
    problem: str
    """Reason why the job does not count; empty if it counts."""

    @property
    def seed(self) -> int:
        """The seed of a finished job; 0 where no file has it."""
        text = _value(self, SEED)
        return 0 if text == tables.DASH else int(text)

    @property
    def best(self) -> pd.Series:
        """The validation with the highest MPSNR, that of `best.ckpt`."""
        return self.validations.loc[self.validations["val/mpsnr"].idxmax()]


def is_sweep(folder: Path) -> bool:
    """Whether a folder holds jobs of a sweep of trainings."""
    return any(any(folder.glob(f"*/{name}")) for name in (runs.METRICS, runs.FAILURE))


def section(folder: Path, options: Options) -> Section:
    """The section of a sweep.

    Raises:
        InputError: No row has the values of the reference.
    """
    jobs = read_jobs(folder)
    finished = [job for job in jobs if not job.problem]
    left_out = [job for job in jobs if job.problem]
    failures = {"Left out of all figures and means": _problems(left_out, varying(jobs))} if left_out else {}
    title = f"Sweep: {folder.name}"
    if not finished:
        return Section(title, f"None of {counted(len(jobs), 'job')} has finished.", tables=failures)
    keys, constants = varying(finished), shared(finished)
    variants = _variants(finished, keys)
    reference, why = _reference(variants, keys, constants, options)
    rows, table = single_runs(variants, keys, reference), summary(variants, keys, reference)
    if options.measures_time:
        times = _stack_times({name: of_seeds[0].run for name, of_seeds in variants.items()})
        table["stack_ffts"] = [times.get(name, math.nan) for name in variants]
    labels = {name: label(keys, name) for name in variants}
    lines = pd.concat(
        job.validations[["step", "val/mpsnr"]].assign(variant=labels[name], seed=job.seed)
        for name, of_seeds in variants.items()
        for job in of_seeds
    )
    figures = {
        "Best validation MPSNR of every seed (points), and means with 95 % t intervals; right: differences from the "
        "reference, seed by seed": plots.sweep_means(
            rows.assign(variant=[labels[name] for name, of_seeds in variants.items() for _ in of_seeds]),
            table.assign(variant=list(labels.values())),
        ),
        "Validation MPSNR by step: mean over the seeds, and band from the lowest to the highest seed; grey: the "
        "reference": plots.sweep_curves(lines, labels[reference]),
    }
    text = _text(len(jobs), keys, constants, f"{labels[reference]} ({why})", rows, table)
    files, shown = {"sweep.csv": table, "sweep_jobs.csv": rows}, {"By what varies": for_page(table, keys)}
    changes = effects(variants, keys, reference) if len(keys) > 1 else pd.DataFrame()
    if len(changes):
        caption = (
            "Effect of each choice alone: mean of all pairs of settings that differ in nothing else, its spread over "
            "seeds, and its 95 % t interval"
        )
        figures = {caption: plots.sweep_effects(changes), **figures}
        shown, files["sweep_effects.csv"] = {caption: effects_for_page(changes), **shown}, changes
    answer = best_setting(len(jobs), rows, table, list(labels.values()), labels[reference])
    return Section(title, text, figures, {**shown, **failures}, files=files, answer=answer)


# The jobs, and what varies between them.


def read_jobs(folder: Path) -> list[Job]:
    """The jobs of a sweep, in their order."""
    names = (runs.METRICS, runs.FAILURE, runs.CONFIG)
    found = {path.relative_to(folder).parts[0] for name in names for path in folder.glob(f"*/{name}")}
    return [_job(Run(folder / name)) for name in sorted(found, key=_natural)]


def _natural(name: str) -> list[tuple[int, str]]:
    """Sorting key by which job 10 comes after job 9."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", name)]


def _job(run: Run) -> Job:
    """The job of a run folder; one with a damaged file does not count, and says which."""
    known, config = dict[str, str](), dict[str, str]()
    validations, problem = pd.DataFrame(), ""
    try:
        config = flat(run.config) if (run.folder / runs.CONFIG).is_file() else {}
        known = settings(run, config)
        if run.failure:
            problem = f"failed: {run.failure.get('reason', 'it noted no reason')}"
        elif not run.is_finished:
            problem = "not finished: it was stopped, or still goes on"
        else:
            validations = tables.with_numbers(tables.read_table(run.folder / runs.METRICS), "step", "val/mpsnr")
            problem = "no validation was logged" if validations.empty else ""
    except LfrefError as error:
        problem = str(error)
    return Job(run, known, config, validations, problem)


def settings(run: Run, config: Mapping[str, str]) -> dict[str, str]:
    """Key -> value as text, of each override that may change the result; of the configuration if no file has any."""
    has_overrides = any((run.folder / name).is_file() for name in (runs.OVERRIDES, runs.OLD_OVERRIDES))
    if has_overrides or run.failure:
        words = map(str, run.overrides if has_overrides else run.failure.get("overrides", []))
        entries: Mapping[str, str] = {runs.key_of(word): word.partition("=")[2] for word in words}
    else:
        entries = config
    return {key: text for key, text in entries.items() if re.split(r"[./@]", key)[0] not in PLACES}


def flat(config: Mapping[str, Any], prefix: str = "") -> dict[str, str]:
    """Key such as `net.width` -> its value as text; a list is one value."""
    entries: dict[str, str] = {}
    for name, value in config.items():
        entries |= flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {f"{prefix}{name}": as_text(value)}
    return entries


def as_text(value: Any) -> str:
    """A value as the command line has it."""
    text = value if isinstance(value, str) else yaml.safe_dump(value, default_flow_style=True, width=10_000)
    return text.removesuffix("\n...\n").removesuffix("\n")


def varying(jobs: Sequence[Job]) -> list[str]:
    """Keys whose values differ between the jobs, without the seed."""
    keys = dict.fromkeys(key for job in jobs for key in job.settings if key != SEED)
    return [key for key in keys if len({_value(job, key) for job in jobs}) > 1]


def shared(jobs: Sequence[Job]) -> list[str]:
    """Settings KEY=VALUE that all jobs have, without the seed."""
    common = set.intersection(*(set(job.settings.items()) for job in jobs))
    return [f"{key}={text}" for key, text in jobs[0].settings.items() if (key, text) in common and key != SEED]


def _value(job: Job, key: str) -> str:
    """Value of a key, by the overrides, else by the configuration, else a dash."""
    return job.settings.get(key, job.config.get(key, tables.DASH))


def _variants(jobs: Iterable[Job], keys: Sequence[str]) -> dict[Variant, list[Job]]:
    """The jobs of each variant, in the order of the sweep."""
    variants: dict[Variant, list[Job]] = {}
    for job in jobs:
        variants.setdefault(tuple(_value(job, key) for key in keys), []).append(job)
    return variants


def label(keys: Sequence[str], variant: Variant) -> str:
    """Name of a variant: its value, or `key=value` for several keys, by their last names if these differ."""
    if len(keys) < 2:
        return variant[0] if variant else "all jobs"
    return ", ".join(f"{name}={text}" for name, text in zip(short(keys), variant, strict=True))


def short(keys: Sequence[str]) -> list[str]:
    """The last names of keys, if these differ."""
    names = [key.rpartition(".")[2] for key in keys]
    return names if len({*names}) == len(names) else list(keys)


def _reference(
    variants: Iterable[Variant], keys: Sequence[str], overrides: Sequence[str], options: Options
) -> tuple[Variant, str]:
    """The variant that others are compared with, and why it is."""
    known = list(variants)
    if options.reference is not None:
        for variant in known:
            if _same(variant, options.reference):
                return variant, "as reference= names it"
        columns, rows = ", ".join(keys), "; ".join(", ".join(variant) for variant in known)
        raise InputError(
            f"reference must be the values of a row ({columns}), one of {rows}", got=", ".join(options.reference)
        )
    defaults = options.defaults(overrides)
    for variant in known:
        if keys and all(key in defaults for key in keys) and _same(variant, [defaults[key] for key in keys]):
            return variant, "the default values"
    return known[0], "the first row"


def _same(values: Sequence[str], others: Sequence[str]) -> bool:
    """Whether texts are the same values: 0.5 and .50 are, and [8,8] and [8, 8]."""
    return len(values) == len(others) and all(map(_equals, values, others))


def _equals(one: str, other: str) -> bool:
    try:
        return bool(yaml.safe_load(one) == yaml.safe_load(other))
    except yaml.YAMLError:
        return one == other


# Numbers.


def t_interval(values: Sequence[float]) -> tuple[float, float]:
    """The interval of the mean of independent values; NaN for fewer than two."""
    n = len(values)
    if n < 2:
        return math.nan, math.nan
    series = pd.Series(values, dtype=float)
    half = float(stats.t.ppf((1 + LEVEL) / 2, n - 1)) * series.std() / math.sqrt(n)
    return series.mean() - half, series.mean() + half


def by_seed(jobs: Iterable[Job]) -> pd.Series:
    """Best validation MPSNR of each seed; the mean where a seed was trained more than once."""
    pairs = pd.DataFrame([(job.seed, job.best["val/mpsnr"]) for job in jobs], columns=["seed", "mpsnr"])
    return pairs.groupby("seed")["mpsnr"].mean()


def single_runs(variants: Mapping[Variant, Sequence[Job]], keys: Sequence[str], reference: Variant) -> pd.DataFrame:
    """One row for each finished job: what varies, its seed, its best validation, and its difference from the reference.

    Args:
        variants: Finished jobs of each variant.
        keys: Keys that vary.
        reference: Variant that the others are compared with.
    """
    base = by_seed(variants[reference])
    return pd.DataFrame(
        {
            "job": job.run.name,
            **dict(zip(keys, variant, strict=True)),
            "seed": job.seed,
            "best_mpsnr_db": job.best["val/mpsnr"],
            "best_step": job.best["step"],
            "last_mpsnr_db": job.validations["val/mpsnr"].iloc[-1],
            "mssim": job.best.get("val/mssim", math.nan),
            "difference_db": math.nan if variant == reference else job.best["val/mpsnr"] - base.get(job.seed, math.nan),
            "n_parameters": job.run.training.get("n_parameters"),
            "training_s": job.run.training.get("seconds"),
            "device": job.run.training.get("device"),
        }
        for variant, jobs in variants.items()
        for job in jobs
    )


def summary(variants: Mapping[Variant, Sequence[Job]], keys: Sequence[str], reference: Variant) -> pd.DataFrame:
    """One row for each variant: means over its seeds, and its paired difference from the reference, with intervals.

    Args:
        variants: Finished jobs of each variant.
        keys: Keys that vary.
        reference: Variant that the others are compared with.
    """
    base, rows = by_seed(variants[reference]), []
    for variant, jobs in variants.items():
        values = by_seed(jobs)
        differences = (values - base).dropna() if variant != reference else pd.Series(dtype=float)
        low, high = t_interval(values.tolist())
        difference_low, difference_high = t_interval(differences.tolist())
        rows.append(
            {
                **dict(zip(keys, variant, strict=True)),
                "is_reference": variant == reference,
                "n_seeds": len(values),
                "mean_db": values.mean(),
                "std_db": values.std(),
                "low_db": low,
                "high_db": high,
                "n_pairs": len(differences),
                "difference_db": differences.mean(),
                "difference_low_db": difference_low,
                "difference_high_db": difference_high,
                "mssim": pd.Series([job.best.get("val/mssim", math.nan) for job in jobs]).mean(),
                "n_parameters": _first(job.run.training.get("n_parameters") for job in jobs),
                "training_s": _training_s(jobs),
            }
        )
    return pd.DataFrame(rows)


def effects(variants: Mapping[Variant, Sequence[Job]], keys: Sequence[str], reference: Variant) -> pd.DataFrame:
    """One row for each value of each key that is not the reference's: what that choice alone changes.

    The change of one seed is the mean over all pairs of variants that differ in nothing but this choice, so that the
    other choices count alike.

    Args:
        variants: Finished jobs of each variant.
        keys: Keys that vary.
        reference: Variant whose values the others are compared with.

    Returns:
        Columns `choice, value, compared_with, n_pairs, n_seeds, difference_db, std_db, difference_low_db,
        difference_high_db, training_ratio`; no rows where no two variants differ in one choice only.
    """
    scores = {variant: by_seed(jobs) for variant, jobs in variants.items()}
    seconds = {variant: _training_s(jobs) for variant, jobs in variants.items()}
    rows = []
    for place, key in enumerate(keys):
        for value in dict.fromkeys(variant[place] for variant in variants if variant[place] != reference[place]):
            alone = {variant: (*variant[:place], reference[place], *variant[place + 1 :]) for variant in variants}
            pairs = [(one, other) for one, other in alone.items() if one[place] == value and other in scores]
            if not pairs:
                continue
            changes = pd.concat([scores[one] - scores[other] for one, other in pairs], axis=1).mean(axis=1).dropna()
            if changes.empty:
                continue
            low, high = t_interval(changes.tolist())
            rows.append(
                {
                    "choice": key,
                    "value": value,
                    "compared_with": reference[place],
                    "n_pairs": len(pairs),
                    "n_seeds": len(changes),
                    "difference_db": changes.mean(),
                    "std_db": changes.std(),
                    "difference_low_db": low,
                    "difference_high_db": high,
                    "training_ratio": sum(seconds[one] for one, _ in pairs) / sum(seconds[other] for _, other in pairs),
                }
            )
    return pd.DataFrame(rows)


def _training_s(jobs: Iterable[Job]) -> float:
    """Mean seconds of training; NaN where no job noted them."""
    return float(pd.Series([job.run.training.get("seconds") for job in jobs], dtype=float).mean())


def _first(values: Iterable[int | None]) -> int | None:
    return next((value for value in values if value is not None), None)


def _stack_times(networks: Mapping[Variant, Run]) -> dict[Variant, float]:
    """Median time for the stack of a patch by each variant, in NumPy's 4-D FFTs of the same views, all in turns.

    Networks that correct another method's stack are left out: the time of that method depends on the views. So are
    runs whose checkpoint was deleted.
    """
    watches: dict[tuple[str, Variant], Callable[[], float]] = {}
    for name, run in networks.items():
        try:
            refocuser, patch = load(run.folder), run.config.get("data", {}).get("patch")
        except LfrefError:
            continue
        if not isinstance(refocuser, NetworkRefocuser) or refocuser.grid is None or patch is None:
            continue
        shape = (*refocuser.grid, refocuser.network.config["channels"], patch, patch)
        views = torch.rand(shape, generator=torch.Generator().manual_seed(0))
        stack = functools.partial(refocuser, views)
        watches["stack", name] = functools.partial(timing.seconds, stack, views.device)
        watches["fft", name] = functools.partial(timing.numpy_fft_time, views)
    with torch.no_grad():
        spent = timing.in_turns(watches, range(ROUNDS), warmup=1)
    medians = {key: pd.Series(times).median() for key, times in spent.items()}
    return {name: medians["stack", name] / medians["fft", name] for kind, name in medians if kind == "stack"}


# The page.


def for_page(table: pd.DataFrame, keys: Sequence[str]) -> pd.DataFrame:
    """The summary with means, deviations and intervals as text; bold where an interval excludes 0."""
    shown = table[[*keys]].set_axis(short(keys), axis=1).assign(n_seeds=table["n_seeds"])
    shown["mean_and_std"] = [_mean_and_std(row) for row in table.to_dict("records")]
    if len(table) > 1:
        shown["difference"] = [_difference(row) for row in table.to_dict("records")]
    costs = ["mssim"] if table["mssim"].notna().any() else []  # a refiner has none
    costs += [name for name in ("n_parameters", "training_s", "stack_ffts") if name in table]
    return shown.assign(**table[costs])


def effects_for_page(table: pd.DataFrame) -> pd.DataFrame:
    """The effects with their spread and intervals as text; bold where an interval excludes 0."""
    rows = [row | {"is_reference": False} for row in table.to_dict("records")]
    return table[["choice", "value", "compared_with", "n_pairs", "n_seeds"]].assign(
        change=[_difference(row) for row in rows], std_db=table["std_db"], training_ratio=table["training_ratio"]
    )


def best_setting(n_jobs: int, rows: pd.DataFrame, table: pd.DataFrame, names: Sequence[str], reference: str) -> str:
    """The best setting, how far it is from the reference, and what the sweep cost, in a sentence.

    Args:
        n_jobs: Number of all jobs, with those that did not finish.
        rows: Table of single runs.
        table: Summary of the variants.
        names: Name of each row of the summary.
        reference: Name of the reference.
    """
    place = int(table["mean_db"].to_numpy().argmax())
    best, base = table.iloc[place], table[table["is_reference"]].iloc[0]
    spread = "" if math.isnan(best["std_db"]) else f" \N{PLUS-MINUS SIGN} {best['std_db']:.2f}"
    words = f"Best of {counted(len(table), 'setting')}: {names[place]}, with {best['mean_db']:.2f}{spread} dB"
    words += f" over {counted(int(best['n_seeds']), 'seed')}"
    if best["is_reference"]:
        words += ", the reference itself" if len(table) > 1 else ""
    elif best["n_pairs"]:
        difference = f"{abs(best['difference_db']):.2f} dB {'above' if best['difference_db'] >= 0 else 'below'}"
        words += f", {difference} the reference ({reference})"
        low, high = best["difference_low_db"], best["difference_high_db"]
        if low <= 0 <= high:
            words += ", which seeds alone may explain"
        elif math.isnan(low):
            words += " by a single seed, which proves nothing"
        ratio = f"{best['training_s'] / base['training_s']:.2g}"
        costs = {"nan": "", "1": ", in as much training time"}
        words += costs.get(ratio, f", in {ratio} times its training time")
    total = tables.format_cell("training_s", float(rows["training_s"].sum()))
    known = rows["training_s"].notna().all()
    return f"{words}; {counted(len(rows), 'job')} of {n_jobs} took {total} in all." if known else f"{words}."


def _mean_and_std(row: Mapping[str, Any]) -> str:
    return f"{row['mean_db']:.2f}" + ("" if math.isnan(row["std_db"]) else f" ± {row['std_db']:.2f}")


def _difference(row: Mapping[str, Any]) -> str:
    if row["is_reference"]:
        return "reference"
    mean, low, high = (row[f"difference_{name}db"] for name in ("", "low_", "high_"))
    if math.isnan(mean):
        return tables.DASH
    if math.isnan(low):
        return f"{mean:+.2f}".replace("-", tables.MINUS)
    text = f"{mean:+.2f} ({low:+.2f} to {high:+.2f})".replace("-", tables.MINUS)
    return tables.Bold(text) if low > 0 or high < 0 else text


def _problems(jobs: Sequence[Job], keys: Sequence[str]) -> pd.DataFrame:
    return pd.DataFrame(
        {
            "job": job.run.name,
            **{key: _value(job, key) for key in keys},
            "seed": _value(job, SEED),
            "problem": job.problem,
        }
        for job in jobs
    )


def _text(
    n_jobs: int, keys: Sequence[str], constants: Sequence[str], reference: str, rows: pd.DataFrame, table: pd.DataFrame
) -> str:
    """The text above the table: what all jobs share, the reference, and how to read the numbers."""
    lines = [f"All rows: {' '.join(constants)}." if constants else "The rows share no override."]
    lines += [f"What varies: {', '.join(keys)}."] if keys else []
    lines.append(f"{len(rows)} of {counted(n_jobs, 'job')} finished, {counted(len(table), 'variant')}.")
    if len(rows) < n_jobs:
        lines.append("The others are listed with their reasons below, and count in no mean.")
    what = "MPSNR is the best of a run's validations, against its own labels; ± is the standard deviation over seeds."
    if len(table) > 1:
        what += f" Reference: {reference}. Differences are taken seed by seed, variant less reference."
    if (table["n_pairs"] > 1).any():
        what += (
            " In brackets: the 95 % paired t interval of the mean difference, bold if it excludes 0. Each row is "
            "tested by itself: of 20 variants without an effect, about one is bold."
        )
    elif len(table) > 1:
        what += " With one seed they have no interval: add seed=0,1,2 to the sweep."
    costs = "Training is the mean wall time over seeds, validations included"
    devices = sorted({*rows["device"].dropna()})
    costs += f", on {' and '.join(devices)}." if devices else "; these runs did not note it."
    if len(devices) > 1:
        costs += " Times on different devices cannot be compared."
    if "stack_ffts" in table:
        costs += (
            " The time of a stack is that of the best checkpoint for a patch of training size on this machine, in "
            "NumPy's 4-D FFTs of the same views."
        )
    return "\n\n".join([" ".join(lines), what, costs])
